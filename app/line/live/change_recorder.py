"""The changes of a line that become events, recorded in order and within a budget; and the lookup in the
history since when a condition holds that was there at the start.

`ChangeDetector` and `EventBudget` are pure. `ChangeRecorder` never delays the caller that reports a change: a
change that cannot be written now waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import structlog

from app.errors import StoreError
from app.line.conditions.catalogue import PORT_LOST, STATUS
from app.line.conditions.condition import Condition
from app.line.conditions.unit import BY_READING, UNIT_OFFLINE
from app.line.live.bus_live import (
    BusLive,
    LiveState,
    Onset,
    WordSpan,
    offline_after_s,
    onset_in,
    scan_s_of,
    status_conditions,
)
from app.people.audit.entry import EventKind
from app.people.audit.log import EventLog
from bus.catalogue.values import status_bits
from bus.contract import BusFigures, BusLink, BusLinkState, Reading, UnitLink, UnitLinkState, Update
from bus.instants import DAY_S, HOUR_S, Clock, Monotonic, UnixTime, monotonic_now
from bus.messages import Message
from bus.pacing import Bucket
from bus.settings import BusSettings

PORT_REMARKS = frozenset(("diagnosis_port_changed", "diagnosis_port_changed_by", "diagnosis_port_shared"))
"""Remarks of a bus's diagnosis that become events."""


@dataclass(frozen=True, slots=True)
class LineEvent:
    """An event to be recorded, of a unit or, with ``unit`` None, of the bus."""

    kind: EventKind
    unit: int | None
    at: UnixTime
    what: Message
    old: Message | str
    new: Message | str
    message: Message | None = None
    series: str = ""
    """Separates events of one unit and kind that must not crowd out each other."""
    count: int = 0
    """The number of occurrences that the event sums up, from the first on; it becomes `new`."""


@dataclass(slots=True)
class ChangeDetector:
    """A detector that compares each update of a bus with the last state. The first state is no change."""

    settings: BusSettings
    _port: BusLinkState | None = None
    _conditions: dict[int, frozenset[str]] = field(default_factory=dict)
    _links: dict[int, UnitLinkState] = field(default_factory=dict)
    _remarks: list[Message] = field(default_factory=list)

    def detect(self, update: Update) -> list[LineEvent]:
        """Return the changes that this update makes."""
        match update:
            case Reading():
                return self._compare_reading(update)
            case UnitLink():
                return self._compare_unit_link(update)
            case BusLink():
                return self._compare_port(update)
            case BusFigures():
                return self._compare_remarks(update)
        return []

    def _compare_reading(self, reading: Reading) -> list[LineEvent]:
        before = self._conditions.get(reading.unit)
        now = status_conditions(status_bits(reading.outputs, reading.inputs, self.settings.estop_healthy))
        self._conditions[reading.unit] = now
        if before is None or before == now:
            return []
        changed = [row for row in BY_READING if row.event and (row.code in before) != (row.code in now)]
        return [_event(row, reading.unit, reading.at, row.code in now) for row in changed]

    def _compare_unit_link(self, update: UnitLink) -> list[LineEvent]:
        before = self._links.get(update.unit, "unknown")
        if update.link not in ("online", "offline") or update.link == before:
            return []
        if update.link == "offline" and self._port == "closed":
            return []
        self._links[update.unit] = update.link
        if before == "unknown":
            return []
        return [_event(UNIT_OFFLINE, update.unit, update.at, update.link == "offline", update.cause)]

    def _compare_remarks(self, figures: BusFigures) -> list[LineEvent]:
        """Return an event for each new remark that another program uses the port or changed its settings."""
        before = self._remarks
        self._remarks = [each for each in figures.diagnosis if each.code in PORT_REMARKS]
        new = [each for each in self._remarks if each not in before]
        return [LineEvent("bus", None, figures.at, each, "", "", series=each.code) for each in new]

    def _compare_port(self, update: BusLink) -> list[LineEvent]:
        before, self._port = self._port, update.link
        if before is None or before == update.link:
            return []
        return [_event(PORT_LOST, None, update.at, update.link == "closed", update.cause)]


def _event(
    row: Condition[Any], unit: int | None, at: UnixTime, holds: bool, cause: Message | None = None
) -> LineEvent:
    """Return the event of a condition that began or ended."""
    event = row.event
    assert event is not None
    code, words = (event.began, (event.off, event.on)) if holds else (event.ended, (event.on, event.off))
    what = Message.of(f"{code}_because", cause=cause) if holds and cause else Message(code)
    return LineEvent(event.kind, unit, at, what, *words)


RETRY_AFTER_S = 1.0
BURST = 20
"""Changes of one series that are recorded individually."""
FEW = 6
"""The most changes of a port or a worker before they are summed up."""
FORGIVEN_EVERY_S = 60.0
"""The seconds until a series may have one more event of its own."""
QUIET_S = 60.0
FIRST_PAUSE_S, MAX_PAUSE_S = 60.0, 3600.0
MAX_WAITING = 10_000
"""The most changes kept in memory while the log cannot be written; beyond it the oldest are left out."""
DUE_EVERY_S = 1.0
"""The seconds between two checks for due summaries."""

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Summary:
    """The last of ``count`` events of a series that came within ``seconds``."""

    last: LineEvent
    count: int
    seconds: float


@dataclass(slots=True)
class _Series:
    bucket: Bucket
    last: LineEvent | None = None
    count: int = 0
    first_at: Monotonic = Monotonic(0.0)
    last_at: Monotonic = Monotonic(0.0)
    due_at: Monotonic = Monotonic(0.0)
    pause_s: float = FIRST_PAUSE_S


class EventBudget:
    """A limit on how many changes of each series become events. A contact that chatters, or a port that opens
    and closes, would fill the log and hide everything else. Once a series has had its share, only its last
    change is recorded, with a count: as soon as the series is quiet, else after pauses that double. ``now``
    is monotonic, in seconds."""

    def __init__(self) -> None:
        self._series: dict[Hashable, _Series] = {}

    def admits(
        self, key: Hashable, event: LineEvent, now: Monotonic, *, burst: int = BURST, count: int = 1
    ) -> bool:
        """Return whether to record this event of a series now, of which ``burst`` are recorded individually.
        Else keep it for a summary, as ``count`` events."""
        series = self._series.setdefault(key, _Series(Bucket(1 / FORGIVEN_EVERY_S, burst)))
        series.last_at = now
        if not series.count and series.bucket.take(now):
            return True
        if not series.count:
            series.first_at, series.due_at = now, now + series.pause_s
        series.last, series.count = event, series.count + count
        return False

    def due(self, now: Monotonic, *, everything: bool = False) -> list[Summary]:
        """Return the summaries to record now; ``everything``: all of them, because the server ends."""
        found = [
            self._summary(series, now)
            for series in self._series.values()
            if series.count and (everything or self._is_due(series, now))
        ]
        self._series = {key: one for key, one in self._series.items() if one.count or one.bucket.level(now)}
        return found

    def _is_due(self, series: _Series, now: Monotonic) -> bool:
        return now >= series.due_at or now - series.last_at >= QUIET_S

    def _summary(self, series: _Series, now: Monotonic) -> Summary:
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
    """The recorder of the changes of one bus, or of the site without ``bus``."""

    def __init__(self, events: EventLog, bus: str | None = None) -> None:
        self._events = events
        self._bus = bus
        self._monotonic = monotonic_now
        self._budget = EventBudget()
        self._queue: asyncio.Queue[LineEvent] = asyncio.Queue()
        self._left_out = 0

    def note(self, change: LineEvent) -> None:
        """Record a change soon, on its own or in a summary."""
        key = (change.unit, change.kind, change.series)
        burst = 1 if change.count else FEW if change.kind in ("bus", "worker") else BURST
        if self._budget.admits(key, change, self._monotonic(), burst=burst, count=change.count or 1):
            self._put(change)

    async def follow(self) -> None:
        """Write the noted changes into the events, in order, until canceled."""
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
        """Wait until all noted changes are in the events, summaries included."""
        self._note_due(everything=True)
        await self._queue.join()

    async def _write(self, change: LineEvent) -> str:
        """Write a change; return why it could not be written, empty when it is on disk."""
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
        """Note, after a write that succeeded, the number of changes left out until then."""
        if self._left_out:
            what = Message.of("event_changes_left_out", n=self._left_out)
            self._left_out = 0
            self._queue.put_nowait(LineEvent("audit", None, at, what, "", ""))


def _summed_up(summary: Summary) -> LineEvent:
    if summary.last.count:
        return replace(summary.last, count=summary.count)
    if summary.count == 1:
        return summary.last
    seconds = round(summary.seconds)
    return replace(summary.last, message=Message.of("events_summed_up", n=summary.count, seconds=seconds))


LOOK_EVERY_S = 1.0
LOOK_AFTER_S = (1.0, 10.0, 60.0)
"""The seconds after which an onset is looked up: once the history has stored it, and again when a worker may
have delivered what it buffered meanwhile."""
BACK_S = (HOUR_S, DAY_S, 7 * DAY_S, 31 * DAY_S, 366 * DAY_S)
"""The seconds to look back, step by step until the beginning is found."""

StatusWords = Callable[[str, int, UnixTime, UnixTime], Awaitable[Sequence[WordSpan]]]
"""A function that returns the stored status bits of a unit in a span, in order. It may raise StoreError."""
OnsetKey = tuple[str, int, str, Onset]


@dataclass(eq=False)
class OnsetLookup:
    """The lookup that corrects the onsets of all units. ``_changed`` is called with bus and unit when an
    onset is corrected."""

    _live: LiveState
    _words: StatusWords
    _changed: Callable[[str, int], None]
    _clock: Clock
    _looked: dict[OnsetKey, int] = field(default_factory=dict)
    """The number of lookups of each open onset."""
    _requested: set[tuple[str, int]] = field(default_factory=set)
    """The units whose last response before this start has been looked up."""

    async def follow(self) -> None:
        """Look up open conditions, as long as the server runs."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            await self.look()

    async def look(self) -> None:
        """Look up each open onset that is due, and the last response of units that have not responded yet."""
        for bus_name, number in self._unread():
            try:
                self._live.buses[bus_name].units[number].last_response = await self._last_end(
                    bus_name, number
                )
            except StoreError:
                break
            self._requested.add((bus_name, number))
        self._looked = {key: self._looked.get(key, 0) for key in self._open()}
        for key, times in list(self._looked.items()):
            if times < len(LOOK_AFTER_S) and self._clock() - key[3].at >= LOOK_AFTER_S[times]:
                self._looked[key] += 1
                await self._look_up(*key)

    def _unread(self) -> list[tuple[str, int]]:
        units = [
            (bus.settings.name, number)
            for bus in self._live.buses.values()
            for number, unit in bus.units.items()
            if unit.reading is None
        ]
        return [unit for unit in units if unit not in self._requested]

    def _open(self) -> list[OnsetKey]:
        return [
            (bus.settings.name, number, name, onset)
            for bus in self._live.buses.values()
            for number, unit in bus.units.items()
            for name, onset in unit.onsets.since.items()
            if name in STATUS and not onset.exact
        ]

    async def _look_up(self, bus_name: str, number: int, name: str, seen: Onset) -> None:
        bus = self._live.buses[bus_name]
        try:
            found = await self._find(bus, number, name, seen)
        except StoreError:
            return
        if bus.units[number].onsets.correct(name, seen, found):
            self._changed(bus_name, number)

    async def _last_end(self, bus: str, number: int) -> UnixTime | None:
        now = self._clock()
        for back_s in BACK_S:
            if spans := await self._words(bus, number, now - back_s, now):
                return spans[-1][1]
        return None

    async def _find(self, bus: BusLive, number: int, name: str, seen: Onset) -> Onset:
        found = seen
        for back_s in BACK_S:
            spans = await self._words(bus.settings.name, number, seen.at - back_s, seen.at)
            found, complete = onset_in(spans, _holds(bus, name), seen, offline_after_s(scan_s_of(bus)))
            if complete:
                break
        return found


def _holds(bus: BusLive, name: str) -> Callable[[int], bool]:
    holds, healthy = STATUS[name], bus.settings.estop_healthy
    return lambda word: holds(status_bits(word >> 8, word & 0xFF, healthy))
