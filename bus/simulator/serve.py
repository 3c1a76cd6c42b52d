"""A simulated line at a real port: one thread that waits, all else is in ``line``.

The thread sleeps until shortly before the next byte is due and watches the clock for the rest, so the
host never gets a byte before a UART would have given it, and hardly later.
"""

from __future__ import annotations

import ctypes
import os
import queue
import select
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from bus.simulator.line import SimulatedLine
from bus.simulator.pacer import Wake
from bus.simulator.ports import Port

T = TypeVar("T")

WATCH_S = 150e-6
"""How long before a frame's last byte is due the thread stops sleeping: what waking up may cost."""
LISTEN_S = 500e-6
"""How long after it the thread stays awake for the host's next request, to know when that came."""
_PR_SET_TIMERSLACK = 29


class LineServer:
    """Serves ``line`` at ``port`` while it is entered; afterwards its units are off and the port is gone."""

    def __init__(self, line: SimulatedLine, port: Port) -> None:
        self.line = line
        self.port = port
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waked, self._waker = os.pipe()
        self._stopping = False
        self._listening_until = 0.0
        self._thread = threading.Thread(target=self._run, name="simulated line", daemon=True)

    def __enter__(self) -> LineServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        os.write(self._waker, b".")
        self._thread.join()
        self.port.unplug()
        os.close(self._waked)
        os.close(self._waker)

    def call(self, change: Callable[[SimulatedLine], T]) -> T:
        """Run ``change`` on the line between two bytes, in its own thread; give its result."""
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(change(self.line))
            except Exception as error:
                future.set_exception(error)

        self._calls.put(run)
        os.write(self._waker, b".")
        return future.result(timeout=10)

    def unplug(self) -> None:
        """Pull the cable: the host's port is gone, and what was under way."""

        def pull(line: SimulatedLine) -> None:
            self.port.unplug()
            line.unplug()

        self.call(pull)

    def plug(self) -> None:
        """Put the cable back; a pseudo-terminal comes back under another name behind the same link."""
        self.call(lambda _line: self.port.plug())

    def _run(self) -> None:
        _sharpen_timer()
        while not self._stopping:
            reply = self.line.advance(time.monotonic())
            if reply:
                self.port.write(reply)
            self._wait(self.line.wake())

    def _wait(self, wake: Wake) -> None:
        now = time.monotonic()
        sleep = 0.0 if now < self._listening_until else wake.at - now - WATCH_S * wake.sharp
        ready, _, _ = select.select([self._waked, *self.port.descriptors()], [], [], max(sleep, 0.0))
        if not ready:
            if wake.sharp and sleep > 0.0:
                while time.monotonic() < wake.at:
                    pass
                self._listening_until = wake.at + LISTEN_S
            return
        if self._waked in ready:
            os.read(self._waked, 64)
            while not self._calls.empty():
                self._calls.get()()
        else:
            now, data = time.monotonic(), self.port.read()
            if data:
                self.line.receive(now, data, self.port.host_baud())


def _sharpen_timer() -> None:
    """Set the thread's timer slack on Linux to the minimum; the usual 50 µs is two percent of a byte time."""
    prctl: Any = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
