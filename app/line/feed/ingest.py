"""The intake of one worker's messages, in their fixed order, with times moved to the app's clock, and within
a quota. The socket itself is in ``app.line.feed.socket``.

``Hello`` → Welcome → ``Snapshot`` → backlog → ``Batch`` after ``Batch``. A batch counts once for each worker
and number; a missing number requests a new snapshot. A malformed message is not applied at all; of a
well-formed one only what is plausible (``app.line.feed.plausibility``).
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import TypeVar

import msgspec

from app.line.feed.channel import Channel, MessageSink
from app.line.feed.plausibility import Coverage, LateReadings, judge_snapshot, sort_updates
from app.line.pipeline import IMPLAUSIBLE, KNOWN, OVER_QUOTA, Pipeline
from bus.contract import (
    Batch,
    BusFigures,
    BusLink,
    ClockSync,
    Delivered,
    Frames,
    Hello,
    MalformedMessageError,
    ParameterValue,
    Progress,
    Reading,
    Result,
    Snapshot,
    TaggedStruct,
    UnitLink,
    Update,
    WantSnapshot,
    WorkerMessage,
    decode_from_worker,
)
from bus.contract.session import ClockOffset
from bus.instants import Clock, ClockWatch, Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message
from bus.pacing import Bucket

PER_S = 2_000.0
"""Updates of the live state a second, each of which goes to every open page."""
MAX_AT_ONCE = 10_000.0
"""The most updates that may come at once: a complete snapshot, or the backlog of a quarter of an hour."""
LATE_COST = 0.25
"""The cost of an update that goes to history only."""
TEXT_COST = 40.0
"""The cost of a diagnosis, or of a state, which is stored and whose cause is translated."""
MAX_BYTES_PER_S, MAX_BYTES_AT_ONCE = 100_000.0, 16_000_000.0
"""The bytes of all messages: below 9 GB a day. A worker's full buffer with a snapshot is 3 MB."""
MAX_VALUES_PER_S, MAX_VALUES_AT_ONCE = 100.0, 40_000.0
"""Stored readings and parameters: twice what a worker polls at 9600 baud, and its full buffer at once."""


@dataclass(slots=True)
class FeedQuota:
    """The limits on messages for one bus, over all connections of its workers."""

    _updates: Bucket = field(default_factory=partial(Bucket, PER_S, MAX_AT_ONCE))
    _bytes: Bucket = field(default_factory=partial(Bucket, MAX_BYTES_PER_S, MAX_BYTES_AT_ONCE))
    _values: Bucket = field(default_factory=partial(Bucket, MAX_VALUES_PER_S, MAX_VALUES_AT_ONCE))

    def pause_s(self, message: WorkerMessage, size: int, now: Monotonic) -> float:
        """Count a message of ``size`` bytes; return the seconds for which nothing more should be read."""
        return max(self._updates.pour(cost_of(message), now), self._bytes.pour(size, now))

    def admits(self, update: Update, now: Monotonic) -> bool:
        """Count an update to be stored; return False if a wire cannot have carried it."""
        match update:
            case Reading() | ParameterValue():
                return self._values.take(now)
            case UnitLink() | BusLink():
                return self._values.take(now, TEXT_COST)
        return True


def cost_of(message: WorkerMessage) -> float:
    """Return the cost of a message to the app, in updates of the live state."""
    match message:
        case Batch(updates=updates, live=True):
            return 1.0 + sum(map(_cost_of_update, updates))
        case Batch(updates=updates):
            return 1.0 + LATE_COST * len(updates)
        case Snapshot(units=units):
            return TEXT_COST + sum(2 + len(unit.parameters) / 8 for unit in units)
    return 1.0


def _cost_of_update(update: Update) -> float:
    match update:
        case Frames(frames=frames):
            return float(len(frames))
        case BusFigures(units=units):
            return TEXT_COST + len(units) / 8
        case UnitLink() | BusLink():
            return TEXT_COST
    return 1.0


SAME_CLOCK_S = 0.05
"""Clocks no further apart than this, in seconds, are one clock: most workers run on the app's machine."""
MAX_DELAY_S = 5.0
"""A message that seems to be later than this, in seconds, shows that the clocks differ."""
STEP_S = 0.5
SETTLED_S = 2.5
"""The seconds after a step of the app's own clock in which a message may still have been on its way, or its
worker not have the new time, which is sent once a second."""

M = TypeVar("M", bound=TaggedStruct)

_TIMES = ("at", "sent_at", "acknowledged_at", "proven_at")


class WorkerClock:
    """The seconds to add to one worker's times, from messages with their time of sending.

    A message arrives late by as much as its way and a busy server take, and a clock judged by one direction
    alone is wrong by that much. So the worker states how prompt the app's messages were for it: the true
    offset is between the two (RFC 5905, 8). A message in transit while the app's clock was set back seems to
    have arrived long before it was sent, so after a step nothing is judged until such messages are in.
    """

    def __init__(self) -> None:
        self.offset_s = 0.0
        self._difference = ClockOffset()
        self._own: ClockWatch | None = None
        self._settled_at = Monotonic(-inf)

    def observe(
        self,
        sent_at: UnixTime,
        received_at: UnixTime,
        running: Monotonic,
        app_behind_s: float | None = None,
    ) -> float:
        """Add the sample of one message; return by how much a *known* clock has stepped, mostly 0.0.
        ``running``: its arrival on a clock that cannot be set. ``app_behind_s``: see Snapshot."""
        if self._own_stepped(received_at, running):
            return 0.0
        first = self._difference.seconds is None
        self._difference.observe(sent_at, received_at)
        difference = self._difference.seconds or 0.0
        return self._settle(0.0 if _is_one_clock(difference, app_behind_s) else difference, first)

    def _own_stepped(self, received_at: UnixTime, running: Monotonic) -> bool:
        """Return whether this is too soon after a step of the app's clock. The clock of a worker on another
        machine differs by that step now; a worker on this machine has made the step too."""
        self._own = self._own or ClockWatch(received_at, running)
        step = self._own.step(received_at, running)
        if step:
            self._difference = ClockOffset()
            self._settled_at = running + SETTLED_S
            if self.offset_s:
                self.offset_s += step
        return running < self._settled_at

    def _settle(self, wanted: float, first: bool) -> float:
        change = wanted - self.offset_s
        if abs(change) < SAME_CLOCK_S and wanted != 0.0:
            return 0.0
        self.offset_s = wanted
        return change if abs(change) >= STEP_S and not first else 0.0


def _is_one_clock(difference: float, app_behind_s: float | None) -> bool:
    """Return whether the difference could come from late messages alone, in either direction."""
    if app_behind_s is None or app_behind_s <= -SAME_CLOCK_S:
        return abs(difference) < SAME_CLOCK_S
    return -SAME_CLOCK_S < difference < MAX_DELAY_S


def shifted(message: M, offset_s: float) -> M:
    """Return the same message, and all its parts, with every time moved by ``offset_s``."""
    if offset_s == 0.0:
        return message
    changed: dict[str, object] = {}
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if name in _TIMES and value is not None:
            changed[name] = value + offset_s
        elif isinstance(value, TaggedStruct):
            changed[name] = shifted(value, offset_s)
        elif isinstance(value, list) and value and isinstance(value[0], TaggedStruct):
            changed[name] = [shifted(part, offset_s) for part in value]
    return msgspec.structs.replace(message, **changed)


@dataclass(slots=True)
class IngestPosition:
    """The position of the app in the messages of one worker. ``seq``: its last batch that is safe here."""

    worker: str
    seq: int = 0


class Refused(dict[Message, int]):
    """The number of updates of a batch refused for each reason; usually empty."""

    def count(self, reason: Message, updates: int) -> None:
        """Add a number of refused updates for a reason."""
        if updates:
            self[reason] = self.get(reason, 0) + updates


@dataclass(eq=False, repr=False)
class Ingest:
    """A connection of a worker. ``quota`` and ``coverage`` belong to the bus, over all its connections."""

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
    """Consecutive ticks in which nothing came, though more would have been read."""
    _is_held_back: bool = False
    _late: LateReadings = field(default_factory=LateReadings)
    """The late readings since the last batch without any."""

    def __post_init__(self) -> None:
        self._units: Collection[int] = self._pipeline.units
        self._window = self._coverage.window(self._now())
        self._pipeline.since = self._window.since
        self._settled = self._delivered = self._received.seq

    async def receive(self, data: bytes) -> None:
        """Take one message, and return once the next may come. Raise MalformedMessageError for one of which
        nothing was applied."""
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
        """Return whether a message has a piece of the trace that the app has requested: an hour of it would
        use up the quota, and later messages would wait until the link is lost."""
        return isinstance(message, Batch) and any(
            isinstance(update, Result) and update.frames and self._channel.awaits(update.id)
            for update in message.updates
        )

    async def tick(self) -> None:
        """Send the app's time, about once a second, and confirm what arrived a tick ago, because it is on
        disk by now. After a crash of the server the worker sends the rest again."""
        self.missed_ticks += not self._is_held_back
        await self._connection.send(ClockSync(app_time=self._now()))
        if self._delivered != self._settled:
            self._delivered = self._settled
            await self._connection.send(Delivered(seq=self._settled))
        self._settled = self._received.seq

    async def _hold_back(self, seconds: float) -> None:
        """Pause, so that others have their turn between two messages even if ``seconds`` is 0."""
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
        now, refused = self._now(), Refused()
        found = sort_updates(batch.updates, self._units, now, live=batch.live)
        refused.count(IMPLAUSIBLE, found.refused)
        for update in (*found.late, *found.live):
            if isinstance(update, Result | Progress):
                self._channel.on_update(update, self._connection)
        late: list[Update] = []
        if found.late:
            # Late updates of a live batch were delayed on their way: the app stood still.
            until = now if batch.live else self._window.until
            late = self._within_quota(self._in_window(found.late, until, refused), refused)
            self._pipeline.batch(late, live=False)
            self._late.add(late)
        elif self._late.count:
            self._pipeline.readings_came_late(now, self._late.count, self._late.since, self._late.until)
            self._late = LateReadings()
        if found.live:
            # The present is shown even if history takes no more.
            unknown = [update for update in found.live if not self._window.is_known(update)]
            refused.count(KNOWN, len(found.live) - len(unknown))
            stored = self._within_quota(unknown, refused)
            self._pipeline.batch(found.live, live=True, stored=stored)
        self._coverage.advance(batch, [*late, *found.live], now)
        if refused:
            self._pipeline.updates_refused(now, refused)

    def _in_window(self, late: Sequence[Update], until: UnixTime, refused: Refused) -> list[Update]:
        """Return the updates from the time that was not followed, without repetitions after a crash."""
        fresh = [update for update in late if not self._window.is_repeated(update)]
        taken = [update for update in fresh if self._window.admits(update, self._clock.offset_s, until)]
        refused.count(KNOWN, len(fresh) - len(taken))
        return taken

    def _within_quota(self, updates: Sequence[Update], refused: Refused) -> list[Update]:
        """Return the updates except those that no wire can have carried."""
        now = monotonic_now()
        taken = [update for update in updates if self._quota.admits(update, now)]
        refused.count(OVER_QUOTA, len(updates) - len(taken))
        return taken

    def _note_time(self, message: Snapshot | Batch) -> None:
        now = self._now()
        step = self._clock.observe(message.sent_at, now, monotonic_now(), message.app_behind_s)
        if step:
            self._pipeline.clock_stepped(step, now)
