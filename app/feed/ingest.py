"""What a worker says, in its fixed order of speech, taken in whole or not at all.

``Hello`` → Welcome → ``Snapshot`` → backlog → ``Batch`` after ``Batch``. A batch counts once for each
worker and number; a missing number asks for a new snapshot. No socket here: bytes in, messages out.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from app.feed.channel import Channel, Connection
from app.feed.clock import WorkerClock, shifted
from app.pipeline import Pipeline
from bus.contract import (
    Batch,
    Clock,
    Delivered,
    Hello,
    Progress,
    Result,
    Snapshot,
    WantSnapshot,
    WorkerMessage,
    decode_from_worker,
)


class MalformedMessageError(Exception):
    """The worker sent what the contract forbids; its connection ends with this reason."""


@dataclass(slots=True)
class Received:
    """How far the app has followed one worker. ``seq``: its last batch that is safe here."""

    worker: str
    seq: int = 0


class Ingest:
    """One connection of one worker."""

    def __init__(
        self,
        hello: Hello,
        received: Received,
        channel: Channel,
        pipeline: Pipeline,
        connection: Connection,
        now: Callable[[], float] = time.time,
    ) -> None:
        self.hello = hello
        self._received = received
        self._channel = channel
        self._pipeline = pipeline
        self._connection = connection
        self._now = now
        self._clock = WorkerClock()
        self._snapshot_seq: int | None = None
        self._snapshot_wanted = False
        self._settled = self._delivered = received.seq
        self.silent_ticks = 0
        """How many ticks in a row nothing was heard."""
        self._clock.hear(hello.sent_at, now(), time.monotonic())

    async def receive(self, data: bytes) -> None:
        """One message. Raises MalformedMessageError; nothing of such a message was applied."""
        self.silent_ticks = 0
        self._channel.on_message()
        match decode(data):
            case Snapshot() as snapshot:
                await self._take_snapshot(snapshot)
            case Batch() as batch:
                await self._take_batch(batch)
            case Hello():
                raise MalformedMessageError("hello is said once, at the beginning")

    async def tick(self) -> None:
        """About once a second: the app's time, and what may be forgotten: it was here a tick ago, so it is
        on disk by now, and a server that dies is told it again."""
        self.silent_ticks += 1
        await self._connection.send(Clock(app_time=self._now()))
        await self._confirm(self._settled)
        self._settled = self._received.seq

    async def _take_snapshot(self, snapshot: Snapshot) -> None:
        self._hear(snapshot.sent_at)
        first = self._snapshot_seq is None
        self._snapshot_seq = snapshot.seq
        self._snapshot_wanted = False
        self._pipeline.snapshot(self.hello.bus, shifted(snapshot, self._clock.offset_s), self.hello.software)
        if first:
            await self._channel.opened(self._connection, self.hello.worker)

    async def _take_batch(self, batch: Batch) -> None:
        if self._snapshot_seq is None:
            raise MalformedMessageError("a snapshot comes before the first batch")
        if batch.live:
            self._hear(batch.sent_at)
            await self._miss(batch, max(self._received.seq, self._snapshot_seq) + 1)
        if batch.seq <= self._received.seq:
            return
        self._received.seq = batch.seq
        updates = [shifted(update, self._clock.offset_s) for update in batch.updates]
        for update in updates:
            if isinstance(update, Result | Progress):
                self._channel.on_update(update, self._connection)
        self._pipeline.batch(self.hello.bus, updates, live=batch.live)

    async def _miss(self, batch: Batch, expected: int) -> None:
        if batch.seq > expected and not self._snapshot_wanted:
            self._snapshot_wanted = True
            await self._connection.send(WantSnapshot())

    async def _confirm(self, seq: int) -> None:
        if self._delivered != seq:
            self._delivered = seq
            await self._connection.send(Delivered(seq=seq))

    def _hear(self, sent_at: float) -> None:
        now = self._now()
        step = self._clock.hear(sent_at, now, time.monotonic())
        if step:
            self._pipeline.clock_stepped(self.hello.bus, step, now)


def decode(data: bytes) -> WorkerMessage:
    """One message of a worker. Raises MalformedMessageError."""
    try:
        return decode_from_worker(data)
    except (msgspec.DecodeError, ValueError) as error:
        raise MalformedMessageError(f"not a message of a bus worker: {error}") from error
