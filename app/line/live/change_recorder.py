"""Selects the changes of a line that become events. Pure: updates in, changes out.

Records the changes of a bus in the event log, in order and within a budget, and never holds up who reports
them: what cannot be written now waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import structlog

from app.errors import StoreError
from app.line.conditions.catalogue import PORT_LOST
from app.line.conditions.condition import Condition
from app.line.conditions.unit import BY_READING, UNIT_OFFLINE
from app.line.live.unit_status import status_conditions
from app.people.audit.entry import EventKind
from app.people.audit.log import EventLog
from bus.bucket import Bucket
from bus.catalogue.status import status_bits
from bus.contract import BusFigures, BusLink, BusLinkState, Reading, UnitLink, UnitLinkState, Update
from bus.instants import Monotonic, UnixTime, monotonic_now
from bus.messages import Message
from bus.settings import BusSettings

PORT_REMARKS = frozenset(("diagnosis_port_changed", "diagnosis_port_changed_by", "diagnosis_port_shared"))
"""Of a diagnosis, which become events."""


@dataclass(frozen=True, slots=True)
class LineEvent:
    """An event to be recorded. ``unit`` None: the bus."""

    kind: EventKind
    unit: int | None
    at: UnixTime
    what: Message
    old: Message | str
    new: Message | str
    message: Message | None = None
    series: str = ""
    """Separates series of one unit and kind, where one must not crowd out the other."""
    count: int = 0
    """How many it stands for, of what is summed up from the first on: it becomes `new`."""


@dataclass(slots=True)
class Changes:
    """The last state of one bus. The first state seen is no change."""

    settings: BusSettings
    _port: BusLinkState | None = None
    _conditions: dict[int, frozenset[str]] = field(default_factory=dict)
    _links: dict[int, UnitLinkState] = field(default_factory=dict)
    _remarks: list[Message] = field(default_factory=list)

    def see(self, update: Update) -> list[LineEvent]:
        """What this update changes, compared with the one before."""
        match update:
            case Reading():
                return self._see_reading(update)
            case UnitLink():
                return self._see_unit_link(update)
            case BusLink():
                return self._see_port(update)
            case BusFigures():
                return self._see_remarks(update)
        return []

    def _see_reading(self, reading: Reading) -> list[LineEvent]:
        before = self._conditions.get(reading.unit)
        now = status_conditions(status_bits(reading.outputs, reading.inputs, self.settings.estop_healthy))
        self._conditions[reading.unit] = now
        if before is None or before == now:
            return []
        changed = [row for row in BY_READING if row.event and (row.code in before) != (row.code in now)]
        return [_event(row, reading.unit, reading.at, row.code in now) for row in changed]

    def _see_unit_link(self, update: UnitLink) -> list[LineEvent]:
        before = self._links.get(update.unit, "unknown")
        if update.link not in ("online", "offline") or update.link == before:
            return []
        if update.link == "offline" and self._port == "closed":
            return []
        self._links[update.unit] = update.link
        if before == "unknown":
            return []
        return [_event(UNIT_OFFLINE, update.unit, update.at, update.link == "offline", update.cause)]

    def _see_remarks(self, figures: BusFigures) -> list[LineEvent]:
        """That another program uses the port or changed its settings."""
        before = self._remarks
        self._remarks = [each for each in figures.diagnosis if each.code in PORT_REMARKS]
        new = [each for each in self._remarks if each not in before]
        return [LineEvent("bus", None, figures.at, each, "", "", series=each.code) for each in new]

    def _see_port(self, update: BusLink) -> list[LineEvent]:
        before, self._port = self._port, update.link
        if before is None or before == update.link:
            return []
        return [_event(PORT_LOST, None, update.at, update.link == "closed", update.cause)]


def _event(
    row: Condition[Any], unit: int | None, at: UnixTime, holds: bool, cause: Message | None = None
) -> LineEvent:
    """That a condition began or ended."""
    event = row.event
    assert event is not None
    code, words = (event.began, (event.off, event.on)) if holds else (event.ended, (event.on, event.off))
    what = Message.of(f"{code}_because", cause=cause) if holds and cause else Message(code)
    return LineEvent(event.kind, unit, at, what, *words)


RETRY_AFTER_S = 1.0
BURST = 20
"""Changes of one series that are recorded one by one."""
FEW = 6
"""How often a port or a worker comes and goes before that is summed up."""
FORGIVEN_EVERY_S = 60.0
"""How long until a series may have one more of these."""
QUIET_S = 60.0
FIRST_PAUSE_S, MAX_PAUSE_S = 60.0, 3600.0
MAX_WAITING = 10_000
"""Changes kept in memory while the log cannot be written; then the oldest are left out, and counted."""
DUE_EVERY_S = 1.0
"""How often it is looked for summaries."""

T = TypeVar("T")
log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Summary(Generic[T]):
    """The last of ``count`` events of a series, which came within ``seconds``."""

    last: T
    count: int
    seconds: float


@dataclass(slots=True)
class _Series(Generic[T]):
    bucket: Bucket
    last: T | None = None
    count: int = 0
    first_at: Monotonic = Monotonic(0.0)
    last_at: Monotonic = Monotonic(0.0)
    due_at: Monotonic = Monotonic(0.0)
    pause_s: float = FIRST_PAUSE_S


class EventBudget(Generic[T]):
    """How many changes of each series of a bus become events. A contact that chatters, or a port that opens
    and closes, would fill the log and hide everything else: once a series has had its share, only its last
    change is kept, with a count, as soon as the series is quiet, and else after pauses that double. The last
    state is always recorded. Pure; ``now`` is monotonic, in seconds."""

    def __init__(self) -> None:
        self._series: dict[Hashable, _Series[T]] = {}

    def admits(self, key: Hashable, event: T, now: Monotonic, *, burst: int = BURST, count: int = 1) -> bool:
        """Whether to record this event of a series, of which ``burst`` are recorded one by one; where not, it
        is kept for a summary, as ``count`` of them."""
        series = self._series.setdefault(key, _Series(Bucket(1 / FORGIVEN_EVERY_S, burst)))
        series.last_at = now
        if not series.count and series.bucket.take(now):
            return True
        if not series.count:
            series.first_at, series.due_at = now, now + series.pause_s
        series.last, series.count = event, series.count + count
        return False

    def due(self, now: Monotonic, *, everything: bool = False) -> list[Summary[T]]:
        """The summaries to record now; ``everything``: all that is kept, because the server ends."""
        found = [
            self._summary(series, now)
            for series in self._series.values()
            if series.count and (everything or self._is_due(series, now))
        ]
        self._series = {key: one for key, one in self._series.items() if one.count or one.bucket.level(now)}
        return found

    def _is_due(self, series: _Series[T], now: Monotonic) -> bool:
        return now >= series.due_at or now - series.last_at >= QUIET_S

    def _summary(self, series: _Series[T], now: Monotonic) -> Summary[T]:
        assert series.last is not None
        summary = Summary(series.last, series.count, now - series.first_at)
        series.last, series.count = None, 0
        if now - series.last_at >= QUIET_S:
            series.pause_s = FIRST_PAUSE_S
        else:
            series.pause_s = min(2 * series.pause_s, MAX_PAUSE_S)
            series.bucket.fill(now)
        return summary


class ChangeRecorder:
    """Of one bus; of the site without ``bus``."""

    def __init__(self, events: EventLog, bus: str | None = None) -> None:
        self._events = events
        self._bus = bus
        self._monotonic = monotonic_now
        self._budget: EventBudget[LineEvent] = EventBudget()
        self._queue: asyncio.Queue[LineEvent] = asyncio.Queue()
        self._left_out = 0

    def note(self, change: LineEvent) -> None:
        """Record this soon, on its own or in a summary."""
        key = (change.unit, change.kind, change.series)
        burst = 1 if change.count else FEW if change.kind in ("bus", "worker") else BURST
        if self._budget.admits(key, change, self._monotonic(), burst=burst, count=change.count or 1):
            self._put(change)

    async def follow(self) -> None:
        """Write what was noted into the events, in order, until cancelled."""
        fault = ""
        while True:
            self._note_due()
            try:
                async with asyncio.timeout(DUE_EVERY_S):
                    change = await self._queue.get()
            except TimeoutError:
                continue
            while why := await self._write(change):
                if why != fault:
                    log.error("events wait", error=why, bus=self._bus)
                fault = why
                await asyncio.sleep(RETRY_AFTER_S)
            self._queue.task_done()
            self._note_left_out(change.at)

    async def recorded(self) -> None:
        """Wait until everything that was noted is in the events, also what was kept for a summary."""
        self._note_due(everything=True)
        await self._queue.join()

    async def _write(self, change: LineEvent) -> str:
        """Returns why it could not be written; empty when it is on disk."""
        try:
            await self._events.record(
                kind=change.kind,
                bus=self._bus,
                unit=change.unit,
                what=change.what,
                old=change.old,
                new=str(change.count) if change.count else change.new,
                message=change.message or "",
                at=change.at,
            )
        except StoreError as error:
            return str(error)
        return ""

    def _note_due(self, *, everything: bool = False) -> None:
        for summary in self._budget.due(self._monotonic(), everything=everything):
            self._put(_summed_up(summary))

    def _put(self, change: LineEvent) -> None:
        if self._queue.qsize() >= MAX_WAITING:
            self._queue.get_nowait()
            self._queue.task_done()
            self._left_out += 1
        self._queue.put_nowait(change)

    def _note_left_out(self, at: UnixTime) -> None:
        """After a write that succeeded: what had no place until then, as one event."""
        if self._left_out:
            what = Message.of("event_changes_left_out", n=self._left_out)
            self._left_out = 0
            self._queue.put_nowait(LineEvent("audit", None, at, what, "", ""))


def _summed_up(summary: Summary[LineEvent]) -> LineEvent:
    if summary.last.count:
        return replace(summary.last, count=summary.count)
    if summary.count == 1:
        return summary.last
    seconds = round(summary.seconds)
    return replace(summary.last, message=Message.of("events_summed_up", n=summary.count, seconds=seconds))
