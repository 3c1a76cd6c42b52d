"""Updates and traced frames that the app has not confirmed yet: in order, numbered, bounded. No I/O.

A batch gets its number when it is made. After a lost connection everything that the app does not have
(``Welcome.seq``) goes back to the front and is numbered from there, so the app never sees a gap.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import chain

from msgspec.structs import replace

from bus.contract import MAX_UPDATES, Batch, BusFigures, Frames, Progress, Reading, ReadTrace, Result, Update
from bus.instants import Clock, UnixTime
from bus.line.trace import Interpreter, Trace, TracedFrame
from bus.messages import Message
from bus.settings import Dialect

MAX_READINGS = 30_000
"""The most readings that wait: 13 minutes of one bus at 9600 baud (38.4 a second). If there are more, the
oldest tenth is dropped."""
MAX_OTHERS = 10_000
FRAMES_OF_ONE = 10
ENOUGH_WAITING = 1_000
"""The length of the queue from which on momentary updates are not queued."""

Passing = Progress | BusFigures | Frames
"""Momentary updates, which are worth nothing later."""


class Outbox:
    """The queue of updates to the app: ``put`` in, ``next_batch`` out, ``delivered`` forgets.

    In the order of time: ``_sent`` are batches that the app has not confirmed, ``_waiting`` are updates that
    were never sent.
    """

    def __init__(self, most_readings: int = MAX_READINGS, most_others: int = MAX_OTHERS) -> None:
        self._most_readings = most_readings
        self._most_others = most_others
        self._sent: deque[Batch] = deque()
        self._waiting: deque[Update] = deque()
        self._readings = 0
        self._others = 0
        self.seq = 0
        """The number of the last batch made."""
        self._backlog = 0
        """The number of waiting updates that were there when the app came back."""
        self.connected = False
        self.lost = 0
        """Updates dropped since the start because the app was away too long."""
        self.filled = asyncio.Event()

    def __len__(self) -> int:
        return self._readings + self._others

    def put(self, updates: Iterable[Update]) -> None:
        for update in updates:
            if isinstance(update, Passing) and not (self.connected and len(self._waiting) < ENOUGH_WAITING):
                continue
            self._waiting.append(update)
            self._count(update, 1)
        if self._readings > self._most_readings:
            self._drop_oldest(self._readings - self._most_readings, self._most_readings, readings=True)
        if self._others > self._most_others:
            self._drop_oldest(self._others - self._most_others, self._most_others, readings=False)
        self.filled.set()

    def disconnected(self) -> None:
        self.connected = False

    def resume(self, delivered: int, *, oldest: UnixTime = UnixTime(0.0)) -> None:
        """Resume with an app that has every batch up to ``delivered``. All else becomes backlog, except
        updates before ``oldest`` (seconds since the epoch), which the app would refuse."""
        self.delivered(delivered)
        updates = chain(chain.from_iterable(batch.updates for batch in self._sent), self._waiting)
        lasting = [update for update in updates if not isinstance(update, Passing)]
        self._sent.clear()
        self._waiting = deque(update for update in lasting if update.at >= oldest)
        self.lost += len(lasting) - len(self._waiting)
        self._readings = self._others = 0
        for update in self._waiting:
            self._count(update, 1)
        self.seq = delivered
        self._backlog = len(self._waiting)
        self.connected = True

    def next_batch(self, at: UnixTime, app_behind_s: float | None = None) -> Batch | None:
        """Return the next batch to send at ``at`` (epoch seconds), or None if nothing waits.
        ``app_behind_s``: as in Batch."""
        count = min(MAX_UPDATES, self._backlog or MAX_UPDATES, len(self._waiting))
        if not count:
            self.filled.clear()
            return None
        updates = [self._waiting.popleft() for _ in range(count)]
        live = self._backlog == 0
        self._backlog = max(0, self._backlog - count)
        self.seq += 1
        batch = Batch(seq=self.seq, sent_at=at, updates=updates, live=live, app_behind_s=app_behind_s)
        # Momentary updates are not kept: an app that never confirms must not fill the memory.
        self._others -= sum(_weight(update) for update in updates if isinstance(update, Passing))
        lasting = [update for update in updates if not isinstance(update, Passing)]
        if lasting:
            self._sent.append(replace(batch, updates=lasting))
        return batch

    def delivered(self, seq: int) -> None:
        """Drop every batch up to ``seq``, which the app has."""
        while self._sent and self._sent[0].seq <= seq:
            for update in self._sent.popleft().updates:
                self._count(update, -1)

    def _count(self, update: Update, step: int) -> None:
        if isinstance(update, Reading):
            self._readings += step
        else:
            self._others += step * _weight(update)

    def _drop_oldest(self, excess: int, bound: int, *, readings: bool) -> None:
        """Drop the oldest readings, or others, that are too many; the rest keeps its order. At least a tenth
        of ``bound`` is dropped, because each call looks through everything."""
        to_drop = max(excess, bound // 10)

        def left(updates: Iterable[Update]) -> Iterator[Update]:
            nonlocal to_drop
            for update in updates:
                if to_drop > 0 and isinstance(update, Reading) == readings:
                    to_drop -= _weight(update)
                    self._count(update, -1)
                    self.lost += 1
                else:
                    yield update

        unconfirmed = [replace(batch, updates=list(left(batch.updates))) for batch in self._sent]
        self._sent = deque(batch for batch in unconfirmed if batch.updates)
        waiting = deque(left(self._waiting))
        self._backlog = max(0, self._backlog - len(self._waiting) + len(waiting))
        self._waiting = waiting


def _weight(update: Update) -> int:
    """Return the number of updates for which an update counts: a result with a piece of the trace is as large
    as many."""
    return 1 + len(update.frames) // FRAMES_OF_ONE if isinstance(update, Result | Frames) else 1


MAX_TRACES = 8
"""The most reads at once, far more than people and programs request, so that a faulty app cannot fill the
memory."""
FRAMES_AT_A_STRETCH = 25


class TraceReports:
    """The reports of the trace to the app, which do not use the wire. ``put`` receives the updates; ``epoch``
    returns the present time."""

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
        """Report each frame from now on, or stop reporting."""
        self._trace.follower = self._follow if wanted else None

    def read(self, command_id: str, action: ReadTrace) -> None:
        """Begin to read a piece of the trace; its result is reported later."""
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
        """Read the trace in small pieces, so that the wire never waits for it."""
        interpreter, frames = Interpreter(self._dialect), []
        for passed in self._trace.since(action.since):
            frames.append(interpreter.frame(passed))
            if len(frames) >= action.limit:
                break
            if len(frames) % FRAMES_AT_A_STRETCH == 0:
                await asyncio.sleep(0)
        self._put([Result(command_id, self._epoch(), "verified", frames=frames)])
