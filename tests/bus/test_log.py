"""The log of a process, where it can be written and where it cannot."""

from __future__ import annotations

import errno
import io

import pytest
from pydantic import TypeAdapter
from structlog.dev import ConsoleRenderer
from structlog.typing import EventDict

from bus.validation import OneLine
from bus.worker.process import BestEffortStream, without_escapes


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
