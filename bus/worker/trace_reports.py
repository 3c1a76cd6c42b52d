"""The trace as the app gets it: each frame while someone follows it, and pieces of what is kept."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from bus.contract import Frames, ReadTrace, Result, Update
from bus.instants import Clock
from bus.line.trace import Interpreter, Trace, TracedFrame
from bus.messages import Message
from bus.settings import Dialect

MAX_TRACES = 8
"""Read at once, far more than people and programs request: a faulty app must not fill the memory."""
FRAMES_AT_A_STRETCH = 25


class TraceReports:
    """Reads and reports the trace, not the wire. ``put`` receives the updates; ``epoch`` is the time now."""

    def __init__(
        self, trace: Trace, dialect: Dialect, put: Callable[[list[Update]], None], epoch: Clock
    ) -> None:
        self._trace = trace
        self._dialect = dialect
        self._put = put
        self._epoch = epoch
        self._interpreter = Interpreter(dialect)
        self._passed: list[TracedFrame] = []
        self._reading: set[asyncio.Task[None]] = set()

    def follow(self, *, wanted: bool) -> None:
        """Report each frame from now on, or none any more."""
        self._trace.follower = self._follow if wanted else None

    def read(self, command_id: str, action: ReadTrace) -> None:
        """Begin to read a piece; its result follows."""
        if len(self._reading) >= MAX_TRACES:
            self._put([Result(command_id, self._epoch(), "not_sent", Message("too_many_commands"))])
            return
        task = asyncio.ensure_future(self._read(command_id, action))
        self._reading.add(task)
        task.add_done_callback(self._reading.discard)

    def _follow(self, passed: TracedFrame) -> None:
        if not self._passed:
            asyncio.get_running_loop().call_soon(self._report)
        self._passed.append(passed)

    def _report(self) -> None:
        frames = [self._interpreter.frame(passed) for passed in self._passed]
        self._passed.clear()
        self._put([Frames(frames)])

    async def _read(self, command_id: str, action: ReadTrace) -> None:
        """Read the trace in small pieces, so that the wire waits for none of it."""
        interpreter, frames = Interpreter(self._dialect), []
        for passed in self._trace.since(action.since):
            frames.append(interpreter.frame(passed))
            if len(frames) >= action.limit:
                break
            if len(frames) % FRAMES_AT_A_STRETCH == 0:
                await asyncio.sleep(0)
        self._put([Result(command_id, self._epoch(), "verified", frames=frames)])
