"""The log of a process, and that a child ends with its parent."""

from __future__ import annotations

import errno
import io
import os
import select
import signal
import subprocess
import sys

import pytest
from pydantic import TypeAdapter
from structlog.dev import ConsoleRenderer
from structlog.typing import EventDict

from bus.validation import OneLine
from bus.worker.process import PARENT, BestEffortStream, tied_environment, without_escapes


class FullDisk(io.StringIO):
    full = True

    def write(self, text: str) -> int:
        if self.full:
            raise OSError(errno.EFBIG, "File too large")
        return super().write(text)

    def flush(self) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_costs_lines_and_raises_nothing() -> None:
    disk = FullDisk()
    log = BestEffortStream(disk)
    print("lost", file=log, flush=True)
    disk.full = False
    print("kept", file=log, flush=True)
    assert disk.getvalue() == "kept\n"
    disk.close()
    print("the pipe is closed", file=log, flush=True)


HOSTILE = ["/x\x1b[2K", "/x\x9b2K", "/x\x85forged", "/x\u2028forged", "/x\u202egnorw", "/x\x7f"]
HOSTILE += ["/x\rforged", "/x\nforged"]


@pytest.mark.parametrize("sent", HOSTILE)
def test_a_terminal_obeys_nothing_that_a_client_has_sent(sent: str) -> None:
    event = without_escapes(None, "warning", {"event": "request refused", "request": sent})
    line = ConsoleRenderer(colors=False)(None, "warning", event)
    assert len(line.splitlines()) == 1
    assert TypeAdapter(OneLine).validate_python(line) == line


def test_a_text_of_any_script_stays() -> None:
    event: EventDict = {"event": "bus worker", "bus": "Tr\u00e4nke \u05d0", "count": 3}
    assert without_escapes(None, "info", event) == event


CHILD = """
from bus.worker.process import named_parent, tie_to
if parent := named_parent():
    tie_to(parent)
print('tied', flush=True)
input()
"""
PARENT_OF_CHILD = f"""
import subprocess, sys
from bus.worker.process import tied_environment
subprocess.run([sys.executable, "-c", {CHILD!r}], env=tied_environment())
"""


def test_a_child_ends_when_its_parent_is_killed() -> None:
    held, holding = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", PARENT_OF_CHILD], stdin=held, stdout=subprocess.PIPE
    ) as parent:
        os.close(held)
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"tied\n"
        os.kill(parent.pid, signal.SIGKILL)
        # The child holds the pipe open: it ends once the child is gone too.
        ended, _, _ = select.select([parent.stdout], [], [], 10.0)
        os.close(holding)
        assert ended
        assert parent.stdout.read() == b""


def test_a_child_whose_parent_is_gone_already_does_not_begin() -> None:
    gone = tied_environment() | {PARENT: "1"}
    done = subprocess.run([sys.executable, "-c", CHILD], env=gone, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (1, b"")


def test_a_process_without_a_parent_watch_lives_on() -> None:
    free = {name: value for name, value in os.environ.items() if name != PARENT}
    called = [sys.executable, "-c", CHILD]
    assert subprocess.run(called, env=free, input=b"\n", capture_output=True, check=True).stdout == b"tied\n"


def test_what_all_processes_share_loads_nothing_of_the_line() -> None:
    """The server has the log of a worker and its tie, and is 8 MiB smaller without the rest."""
    program = "import sys, bus.worker.process; sys.exit('bus.line' in sys.modules or 'serial' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
