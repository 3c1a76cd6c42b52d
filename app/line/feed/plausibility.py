"""Which updates of a worker are taken in, and what becomes of the others. Pure; times are the app's, seconds.

A worker's clock may be off: its times are moved to the app's clock first (:mod:`app.line.feed.clock`), and
judged here. A value from the future, from longer ago than a worker keeps anything, or of a unit that is not
configured is refused. The state of a port or a unit is not: whatever its time, it holds now. A result is not
either: its outcome is waited for.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from msgspec.structs import replace

from bus.catalogue.values import plausible_speed
from bus.contract import (
    BUFFER_AGE_S,
    Action,
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
from bus.instants import UnixTime

AHEAD_S = 5.0
"""The offset of a clock is known to within the delay of a message."""
LIVE_S = 60.0
"""An older reading is no present state, whatever its mark."""


@dataclass(slots=True)
class Sorted:
    """The updates of a batch: of now, of before, and how many were refused."""

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
    """The snapshot without values from the future and units that are not configured. What it holds may be as
    old as the worker."""
    states = {state.unit: _judged_state(state, now) for state in snapshot.units if state.unit in units}
    figures = snapshot.figures
    return replace(
        snapshot,
        bus=snapshot.bus if _is_past(snapshot.bus.at, now) else replace(snapshot.bus, at=now),
        units=list(states.values()),
        figures=None if figures is None else _judged_figures(figures, units, now),
    )


def result_for(result: Result, action: Action) -> Result:
    """The parts of a result that can belong to ``action``."""
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
    """The reading with None for a speed that the manual rules out, and then with what the unit sent."""
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
    """Figures are never kept: they describe the present, whatever the worker's clock."""
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
    """A value that was requested a moment ago, whatever the worker's clock."""
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
    """Whether a value is too old to be shown as live. A state is not: its time is when it began."""
    return isinstance(update, Reading | ParameterValue | Staged) and update.at < now - LIVE_S
