"""The messages of one worker, in their fixed order: bytes in, messages out, no socket.

``Hello`` → Welcome → ``Snapshot`` → backlog → ``Batch`` after ``Batch``. A batch counts once for each
worker and number; a missing number requests a new snapshot. A malformed message is not applied at all; of a
well-formed one only what is plausible (:mod:`app.feed.plausibility`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from dataclasses import dataclass, field

from app.feed.channel import Channel, MessageSink
from app.feed.clock import WorkerClock, shifted
from app.feed.plausibility import Sorted, judge_snapshot, sort_updates
from app.feed.rates import cost_of
from app.pipeline import Pipeline
from bus.bucket import Bucket
from bus.contract import (
    Batch,
    ClockSync,
    Delivered,
    Hello,
    MalformedMessageError,
    Progress,
    Result,
    Snapshot,
    WantSnapshot,
    WorkerMessage,
    decode_from_worker,
)
from bus.instants import Clock, UnixTime, monotonic_now, unix_now


@dataclass(slots=True)
class IngestPosition:
    """How far the app has followed one worker. ``seq``: its last batch that is safe here."""

    worker: str
    seq: int = 0


@dataclass(eq=False, repr=False)
class Ingest:
    """One connection of one worker. ``bucket`` measures what comes for the bus, over all its connections."""

    _hello: Hello
    _received: IngestPosition
    _channel: Channel
    _pipeline: Pipeline
    _connection: MessageSink
    _bucket: Bucket
    _now: Clock = unix_now
    _clock: WorkerClock = field(default_factory=WorkerClock)
    _snapshot_seq: int | None = None
    _snapshot_wanted: bool = False
    missed_ticks: int = 0
    """Ticks in a row in which nothing came, though more would have been read."""
    _is_held_back: bool = False

    def __post_init__(self) -> None:
        self._units: Collection[int] = self._pipeline.units
        self._settled = self._delivered = self._received.seq
        self._clock.observe(self._hello.sent_at, self._now(), monotonic_now())

    async def receive(self, data: bytes) -> None:
        """Take in one message, and return once the next may come. Raises MalformedMessageError; nothing of
        such a message was applied."""
        self.missed_ticks = 0
        self._channel.on_message()
        message = decode_from_worker(data)
        await self._take(message)
        await self._hold_back(self._bucket.pour(cost_of(message), monotonic_now()))

    async def _take(self, message: WorkerMessage) -> None:
        match message:
            case Snapshot() as snapshot:
                await self._take_snapshot(snapshot)
            case Batch() as batch:
                await self._take_batch(batch)
            case Hello():
                raise MalformedMessageError("Hello is sent once, at the beginning")

    async def tick(self) -> None:
        """About once a second: send the app's time, and confirm what arrived a tick ago, as it is on disk by
        now. A server that crashes gets it again."""
        self.missed_ticks += not self._is_held_back
        await self._connection.send(ClockSync(app_time=self._now()))
        await self._confirm(self._settled)
        self._settled = self._received.seq

    async def _hold_back(self, seconds: float) -> None:
        """Even for no time others have their turn between two messages."""
        self._is_held_back = True
        await asyncio.sleep(seconds)
        self._is_held_back = False

    async def _take_snapshot(self, snapshot: Snapshot) -> None:
        self._note_time(snapshot.sent_at)
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
            self._note_time(batch.sent_at)
            await self._miss(batch, max(self._received.seq, self._snapshot_seq) + 1)
        if batch.seq <= self._received.seq:
            return
        self._received.seq = batch.seq
        shifted_updates = (shifted(update, self._clock.offset_s) for update in batch.updates)
        self._deliver(sort_updates(shifted_updates, self._units, self._now(), live=batch.live))

    def _deliver(self, updates: Sorted) -> None:
        for update in (*updates.late, *updates.live):
            if isinstance(update, Result | Progress):
                self._channel.on_update(update, self._connection)
        if updates.late:
            self._pipeline.batch(updates.late, live=False)
        if updates.live:
            self._pipeline.batch(updates.live, live=True)
        if updates.refused:
            self._pipeline.updates_refused(self._now(), updates.refused)

    async def _miss(self, batch: Batch, expected: int) -> None:
        if batch.seq > expected and not self._snapshot_wanted:
            self._snapshot_wanted = True
            await self._connection.send(WantSnapshot())

    async def _confirm(self, seq: int) -> None:
        if self._delivered != seq:
            self._delivered = seq
            await self._connection.send(Delivered(seq=seq))

    def _note_time(self, sent_at: UnixTime) -> None:
        now = self._now()
        step = self._clock.observe(sent_at, now, monotonic_now())
        if step:
            self._pipeline.clock_stepped(step, now)
