"""The check of a worker's updates: which are accepted, and which refused. Pure.

Times are Unix times of the app's clock, to which those of the worker were moved (``app.line.feed.ingest``). A
value from the future, from longer ago than a worker keeps anything, or of a unit that is not configured is
refused. The state of a port or a unit is accepted with any time, because it holds now, and so is a result,
whose outcome is awaited. Late updates are accepted for the time in which the bus was not followed, each once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from math import inf

from msgspec.structs import replace

from app.line.pipeline import KEPT
from bus.catalogue.values import plausible_speed
from bus.contract import (
    BUFFER_AGE_S,
    Action,
    Batch,
    BusFigures,
    BusLink,
    Frames,
    ParameterValue,
    Progress,
    Reading,
    Result,
    Snapshot,
    Staged,
    UnitLink,
    UnitOutcome,
    UnitState,
    Update,
)
from bus.contract.actions import MAX_UPDATES
from bus.instants import UnixTime

AHEAD_S = 5.0
"""The seconds that a time may be ahead: a clock's offset is known to within a message's delay."""
LIVE_S = 60.0
"""The age in seconds from which a reading is no present state, whatever its mark."""


@dataclass(slots=True)
class Sorted:
    """The updates of a batch: live ones, late ones, and the number refused."""

    live: list[Update] = field(default_factory=list)
    late: list[Update] = field(default_factory=list)
    refused: int = 0


def sort_updates(updates: Iterable[Update], units: Collection[int], now: UnixTime, *, live: bool) -> Sorted:
    """Judge the updates of one batch for a bus of ``units``; ``live`` as the batch is marked."""
    sorted_ = Sorted()
    for update in updates:
        taken = _judged(update, units, now)
        if taken is None:
            sorted_.refused += 1
        elif live and not _is_of_before(taken, now):
            sorted_.live.append(taken)
        else:
            sorted_.late.append(taken)
    return sorted_


def judge_snapshot(snapshot: Snapshot, units: Collection[int], now: UnixTime) -> Snapshot:
    """Return the snapshot without values from the future and units that are not configured. Its values may be
    as old as the worker."""
    states = {state.unit: _judged_state(state, now) for state in snapshot.units if state.unit in units}
    figures = snapshot.figures
    return replace(
        snapshot,
        bus=snapshot.bus if _is_past(snapshot.bus.at, now) else replace(snapshot.bus, at=now),
        units=list(states.values()),
        figures=None if figures is None else _judged_figures(figures, units, now),
    )


def result_for(result: Result, action: Action) -> Result:
    """Return the parts of a result that can belong to ``action``."""
    values = [value for value in result.values if action.returns_values and value.unit == action.only_unit]
    return replace(result, values=values, frames=result.frames[: action.most_frames])


def _judged(update: Update, units: Collection[int], now: UnixTime) -> Update | None:
    match update:
        case Reading():
            is_its_own = update.unit in units and _in_window(update.at, now)
            return believed_reading(update) if is_its_own else None
        case ParameterValue() | Staged():
            return update if update.unit in units and _in_window(update.at, now) else None
        case UnitLink():
            return _held_now(update, now) if update.unit in units else None
        case BusLink():
            return _held_now(update, now)
        case BusFigures():
            return _judged_figures(update, units, now)
        case Frames():
            return Frames([frame for frame in update.frames if _in_window(frame.at, now)])
        case Progress():
            return update if _in_window(update.at, now) else replace(update, at=now)
        case Result():
            return _judged_result(update, units, now)


def believed_reading(reading: Reading) -> Reading:
    """Return the reading with None for a speed that the manual rules out; ``implausible`` then holds what the
    unit sent."""
    commanded, actual = plausible_speed(reading.commanded), plausible_speed(reading.actual)
    if commanded == reading.commanded and actual == reading.actual:
        return reading
    speeds = ((raw or 0).to_bytes(4, "big") for raw in (reading.commanded, reading.actual))
    sent = b"".join(speeds) + bytes((reading.analog, reading.outputs, reading.inputs))
    return replace(reading, commanded=commanded, actual=actual, implausible=sent)


def _in_window(at: UnixTime, now: UnixTime) -> bool:
    return now - BUFFER_AGE_S <= at <= now + AHEAD_S


def _held_now(link: UnitLink | BusLink, now: UnixTime) -> UnitLink | BusLink:
    return link if _in_window(link.at, now) else replace(link, at=now)


def _is_past(at: UnixTime, now: UnixTime) -> bool:
    return UnixTime(0.0) <= at <= now + AHEAD_S


def _judged_state(state: UnitState, now: UnixTime) -> UnitState:
    def is_its_own(value: Reading | ParameterValue) -> bool:
        return value.unit == state.unit and _is_past(value.at, now)

    values = {value.number: value for value in state.parameters if is_its_own(value)}
    reading = state.reading if state.reading is not None and is_its_own(state.reading) else None
    reading = reading and believed_reading(reading)
    at = state.link.at if _is_past(state.link.at, now) else now
    link = replace(state.link, unit=state.unit, at=at)
    return replace(state, link=link, reading=reading, parameters=list(values.values()))


def _judged_figures(figures: BusFigures, units: Collection[int], now: UnixTime) -> BusFigures:
    """Take figures as present, whatever the worker's clock: they are never stored."""
    known = {each.unit: each for each in figures.units if each.unit in units}
    at = figures.at if now - LIVE_S <= figures.at <= now + AHEAD_S else now
    return replace(figures, at=at, units=list(known.values()))


def _judged_result(result: Result, units: Collection[int], now: UnixTime) -> Result:
    outcomes = {each.unit: _judged_outcome(each, now) for each in result.units if each.unit in units}
    return replace(
        result,
        at=result.at if _in_window(result.at, now) else now,
        units=list(outcomes.values()),
        values=[_read_now(value, now) for value in result.values if value.unit in units],
        frames=[frame for frame in result.frames if _in_window(frame.at, now)],
    )


def _read_now(value: ParameterValue, now: UnixTime) -> ParameterValue:
    """Take a value that was requested a moment ago as present, whatever the worker's clock."""
    return value if _in_window(value.at, now) else replace(value, at=now)


def _judged_outcome(outcome: UnitOutcome, now: UnixTime) -> UnitOutcome:
    def known(at: UnixTime | None) -> UnixTime | None:
        return at if at is not None and _in_window(at, now) else None

    return replace(
        outcome,
        sent_at=known(outcome.sent_at),
        acknowledged_at=known(outcome.acknowledged_at),
        proven_at=known(outcome.proven_at),
    )


def _is_of_before(update: Update, now: UnixTime) -> bool:
    """Return whether a value is too old to be shown as live. A state is not: its time is its beginning."""
    return isinstance(update, Reading | ParameterValue | Staged) and update.at < now - LIVE_S


FIRST_S = 900.0
"""The past for which a first worker is believed if its bus has no data: its buffer at 9600 baud."""
REPEATED_S = 5.0
"""Updates this old are sent again after a crash of the app, unconfirmed but stored."""
OFFSET_ERROR_S = 1.0
"""The largest error in seconds of the worker's clock offset when it connects."""


@dataclass(slots=True)
class LateWindow:
    """The span for which one connection may report late: after ``since``, up to ``until``."""

    since: UnixTime
    until: UnixTime
    _newest: dict[int, UnixTime] = field(default_factory=dict)
    """The newest reading of each unit, by the worker's clock."""

    def admits(self, update: Update, offset_s: float, until: UnixTime) -> bool:
        """Return whether a late update is from the time that was not followed, up to ``until``. ``offset_s``:
        by how much its time was moved."""
        if not isinstance(update, KEPT):
            return True
        if not self.since < update.at <= until:
            return False
        return not isinstance(update, Reading) or self._is_next(update, offset_s)

    def is_repeated(self, update: Update) -> bool:
        """Return whether an update is sent again because the app ended before confirming it."""
        return isinstance(update, KEPT) and self.since - REPEATED_S < update.at <= self.since

    def is_known(self, update: Update) -> bool:
        """Return whether a reading of a live batch is from the time before, though young enough to be
        live."""
        return isinstance(update, Reading) and self.since - LIVE_S < update.at <= self.since

    def _is_next(self, reading: Reading, offset_s: float) -> bool:
        """Return whether a reading follows the last one of its unit, by the worker's clock, whose offset may
        change."""
        own_at = reading.at - offset_s
        if own_at <= self._newest.get(reading.unit, UnixTime(-inf)):
            return False
        self._newest[reading.unit] = own_at
        return True


@dataclass(slots=True)
class LateReadings:
    """The number of readings that came late, and their span."""

    count: int = 0
    since: UnixTime = UnixTime(inf)
    until: UnixTime = UnixTime(-inf)

    def add(self, updates: Iterable[Update]) -> None:
        """Count the readings among late updates that were accepted."""
        times = [update.at for update in updates if isinstance(update, Reading)]
        self.count += len(times)
        self.since, self.until = min((self.since, *times)), max((self.until, *times))


@dataclass(slots=True)
class Coverage:
    """The coverage of one bus: up to ``until`` its readings are here, or missing for good. None: nothing is
    known."""

    until: UnixTime | None = None

    def window(self, now: UnixTime) -> LateWindow:
        """Return the span for which a worker that connects now may report late."""
        if self.until is None:
            return LateWindow(now - FIRST_S, now + OFFSET_ERROR_S)
        # After a clock was set back, the readings that follow must not be refused.
        self.until = min(self.until, now)
        return LateWindow(self.until, now + OFFSET_ERROR_S)

    def advance(self, batch: Batch, taken: list[Update], now: UnixTime) -> None:
        """Note the accepted updates of a batch, with times of the app's clock. A live batch that is not full
        holds everything until it was sent."""
        reached = [update.at for update in taken if isinstance(update, Reading)]
        if batch.live and len(batch.updates) < MAX_UPDATES:
            reached.append(batch.sent_at)
        if reached:
            self.until = max(self.until or UnixTime(0.0), min(max(reached), now))
