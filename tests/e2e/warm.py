"""Processes of ``lineside``, forked from one that has imported it: to import it takes seconds of a core, and
the browser tests start dozens. From then on each is a process as any other.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from multiprocessing.context import ForkServerProcess
from pathlib import Path

multiprocessing.get_context("forkserver").set_forkserver_preload(
    ["app.cli.serve", "app.cli.server", "app.cli.simulate"]
)


class WarmProcess:
    """``lineside ARGUMENTS``, with its output added to ``log``."""

    def __init__(self, arguments: list[str], log: Path) -> None:
        log.touch()
        self._process = ForkServerProcess(target=_run, args=(arguments, log))
        self._process.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        assert self._process.pid is not None
        return self._process.pid

    def poll(self) -> int | None:
        """Return its exit code, negative after a signal, or None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float) -> int:
        """Return its exit code once it has ended."""
        self._process.join(timeout)
        status = self.poll()
        assert status is not None, f"process {self.pid} did not end within {timeout:g} s"
        return status

    def send_signal(self, sig: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, sig)


def _run(arguments: list[str], log: Path) -> None:
    """Become the command."""
    # The server of forks ignores it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with log.open("ab") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    sys.argv = ["lineside", *arguments]
    from app.cli import main

    main()
