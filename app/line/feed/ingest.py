"""The messages of one worker, in their fixed order: bytes in, messages out, no socket.

``Hello`` → Welcome → ``Snapshot`` → backlog → ``Batch`` after ``Batch``. A batch counts once for each
worker and number; a missing number requests a new snapshot. A malformed message is not applied at all; of a
well-formed one only what is plausible (:mod:`app.line.feed.plausibility`).
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from app.line.feed.channel import Channel, MessageSink
from app.line.feed.clock import WorkerClock, shifted
from app.line.feed.late import Coverage, LateReadings
from app.line.feed.plausibility import judge_snapshot, sort_updates
from app.line.feed.rates import FeedQuota
from app.line.pipeline import IMPLAUSIBLE, KNOWN, OVER_QUOTA, Pipeline
from bus.contract import (
    Batch,
    ClockSync,
    Delivered,
    Hello,
    MalformedMessageError,
    Progress,
    Result,
    Snapshot,
    Update,
    WantSnapshot,
    WorkerMessage,
    decode_from_worker,
)
from bus.instants import Clock, UnixTime, monotonic_now, unix_now
from bus.messages import Message


@dataclass(slots=True)
class IngestPosition:
    """How far the app has followed one worker. ``seq``: its last batch that is safe here."""

    worker: str
    seq: int = 0


@dataclass(eq=False, repr=False)
class Ingest:
    """One connection of one worker. ``quota`` and ``coverage`` are of the bus, over all its connections."""

    _hello: Hello
    _received: IngestPosition
    _channel: Channel
    _pipeline: Pipeline
    _connection: MessageSink
    _quota: FeedQuota
    _coverage: Coverage
    _now: Clock = unix_now
    _clock: WorkerClock = field(default_factory=WorkerClock)
    _snapshot_seq: int | None = None
    _snapshot_wanted: bool = False
    missed_ticks: int = 0
    """Ticks in a row in which nothing came, though more would have been read."""
    _is_held_back: bool = False
    _late: LateReadings = field(default_factory=LateReadings)
    """Since the last batch without any."""

    def __post_init__(self) -> None:
        self._units: Collection[int] = self._pipeline.units
        self._window = self._coverage.window(self._now())
        self._pipeline.since = self._window.since
        self._settled = self._delivered = self._received.seq

    async def receive(self, data: bytes) -> None:
        """Take in one message, and return once the next may come. Raises MalformedMessageError; nothing of
        such a message was applied."""
        self.missed_ticks = 0
        self._channel.on_message()
        message = decode_from_worker(data)
        size = 0 if self._is_requested(message) else len(data)
        match message:
            case Snapshot() as snapshot:
                await self._take_snapshot(snapshot)
            case Batch() as batch:
                await self._take_batch(batch)
            case Hello():
                raise MalformedMessageError("Hello is sent once, at the beginning")
        await self._hold_back(self._quota.pause_s(message, size, monotonic_now()))

    def _is_requested(self, message: WorkerMessage) -> bool:
        """Whether it has a piece of the trace that the app has requested: an hour of it would use
        up the quota, and what came after it would wait until the link is lost."""
        return isinstance(message, Batch) and any(
            isinstance(update, Result) and update.frames and self._channel.awaits(update.id)
            for update in message.updates
        )

    async def tick(self) -> None:
        """About once a second: send the app's time, and confirm what arrived a tick ago, as it is on disk by
        now. A server that crashes gets it again."""
        self.missed_ticks += not self._is_held_back
        await self._connection.send(ClockSync(app_time=self._now()))
        if self._delivered != self._settled:
            self._delivered = self._settled
            await self._connection.send(Delivered(seq=self._settled))
        self._settled = self._received.seq

    async def _hold_back(self, seconds: float) -> None:
        """Even for no time others have their turn between two messages."""
        self._is_held_back = True
        await asyncio.sleep(seconds)
        self._is_held_back = False

    async def _take_snapshot(self, snapshot: Snapshot) -> None:
        self._note_time(snapshot)
        first = self._snapshot_seq is None
        self._snapshot_seq = snapshot.seq
        self._snapshot_wanted = False
        plausible = judge_snapshot(shifted(snapshot, self._clock.offset_s), self._units, self._now())
        self._pipeline.snapshot(plausible)
        if first:
            await self._channel.opened(self._connection, self._hello.worker)

    async def _take_batch(self, batch: Batch) -> None:
        if self._snapshot_seq is None:
            raise MalformedMessageError("a snapshot comes before the first batch")
        if batch.live:
            self._note_time(batch)
            expected = max(self._received.seq, self._snapshot_seq) + 1
            if batch.seq > expected and not self._snapshot_wanted:
                self._snapshot_wanted = True
                await self._connection.send(WantSnapshot())
        if batch.seq <= self._received.seq:
            return
        self._received.seq = batch.seq
        self._deliver(shifted(batch, self._clock.offset_s))

    def _deliver(self, batch: Batch) -> None:
        now, refused = self._now(), Counter[Message]()
        found = sort_updates(batch.updates, self._units, now, live=batch.live)
        refused[IMPLAUSIBLE] = found.refused
        for update in (*found.late, *found.live):
            if isinstance(update, Result | Progress):
                self._channel.on_update(update, self._connection)
        late: list[Update] = []
        if found.late:
            # Late updates of a live batch were held up on their way: the app stood still.
            until = now if batch.live else self._window.until
            late = self._within_quota(self._in_window(found.late, until, refused), refused)
            self._pipeline.batch(late, live=False)
            self._late.add(late)
        elif self._late.count:
            self._pipeline.readings_came_late(now, self._late.count, self._late.since, self._late.until)
            self._late = LateReadings()
        if found.live:
            # The present is shown, also where history takes no more.
            unknown = [update for update in found.live if not self._window.is_known(update)]
            refused[KNOWN] += len(found.live) - len(unknown)
            stored = self._within_quota(unknown, refused)
            self._pipeline.batch(found.live, live=True, stored=stored)
        self._coverage.advance(batch, [*late, *found.live], now)
        if refused.total():
            self._pipeline.updates_refused(now, refused)

    def _in_window(self, late: Sequence[Update], until: UnixTime, refused: Counter[Message]) -> list[Update]:
        """Those of the time that was not followed; repetitions after a crash are left out."""
        fresh = [update for update in late if not self._window.is_repeated(update)]
        taken = [update for update in fresh if self._window.admits(update, self._clock.offset_s, until)]
        refused[KNOWN] += len(fresh) - len(taken)
        return taken

    def _within_quota(self, updates: Sequence[Update], refused: Counter[Message]) -> list[Update]:
        """Without those that no wire can have carried."""
        now = monotonic_now()
        taken = [update for update in updates if self._quota.admits(update, now)]
        refused[OVER_QUOTA] += len(updates) - len(taken)
        return taken

    def _note_time(self, message: Snapshot | Batch) -> None:
        now = self._now()
        step = self._clock.observe(message.sent_at, now, monotonic_now(), message.app_behind_s)
        if step:
            self._pipeline.clock_stepped(step, now)
