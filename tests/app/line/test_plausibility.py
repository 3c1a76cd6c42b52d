"""Which updates of a worker are taken in, by their time and their unit; the time is passed in."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from app.line.feed.plausibility import (
    AHEAD_S,
    LIVE_S,
    judge_snapshot,
    result_for,
    sort_updates,
)
from bus.contract import (
    BUFFER_AGE_S,
    BusFigures,
    BusLink,
    Frame,
    Frames,
    ParameterValue,
    Progress,
    Reading,
    ReadParameters,
    ReadTrace,
    Result,
    SetSpeed,
    Snapshot,
    Staged,
    UnitFigures,
    UnitLink,
    UnitOutcome,
    UnitState,
    Update,
)

NOW = 2_000_000.0 + BUFFER_AGE_S
UNITS = (1, 2)
READING = Reading(1, NOW, 5, 5, 0, 0, 0)
VALUES: list[Any] = [READING, ParameterValue(1, 3, NOW, 1), Staged(1, NOW, 5)]
STATES: list[Any] = [UnitLink(1, NOW, "offline"), BusLink(NOW, "closed")]


def only(update: Update, *, live: bool = True) -> tuple[str, Update | None]:
    """Where one update went, and as what."""
    found = sort_updates([update], UNITS, NOW, live=live)
    for where, taken in (("live", found.live), ("late", found.late)):
        if taken:
            return where, taken[0]
    assert found.refused == 1
    return "refused", None


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize(
    ("age_s", "where"),
    [
        (-AHEAD_S - 0.1, "refused"),
        (-AHEAD_S, "live"),
        (0.0, "live"),
        (LIVE_S, "live"),
        (LIVE_S + 0.1, "late"),
        (BUFFER_AGE_S, "late"),
        (BUFFER_AGE_S + 0.1, "refused"),
    ],
)
def test_a_value_by_its_age(value: Any, age_s: float, where: str) -> None:
    assert only(replace(value, at=NOW - age_s))[0] == where


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_what_was_kept_is_never_live(value: Any) -> None:
    assert only(value, live=False) == ("late", value)


@pytest.mark.parametrize("value", [*VALUES, STATES[0]], ids=lambda value: type(value).__name__)
def test_a_unit_that_is_not_configured(value: Any) -> None:
    assert only(replace(value, unit=3))[0] == "refused"


@pytest.mark.parametrize("state", STATES, ids=lambda state: type(state).__name__)
@pytest.mark.parametrize("at", [0.0, NOW - BUFFER_AGE_S - 1, NOW + 1e9])
def test_a_state_holds_whatever_its_time(state: Any, at: float) -> None:
    assert only(replace(state, at=at)) == ("live", state)


@pytest.mark.parametrize("state", STATES, ids=lambda state: type(state).__name__)
def test_a_state_that_has_held_for_days_is_live(state: Any) -> None:
    since = replace(state, at=NOW - 3 * 86_400)
    assert only(since) == ("live", since)


def test_figures_are_of_now_and_of_known_units() -> None:
    figures = BusFigures(NOW, 1.0, 1.0, 1.0, 1.0, units=[UnitFigures(1), UnitFigures(9), UnitFigures(1, 7)])
    _, taken = only(figures)
    assert isinstance(taken, BusFigures)
    assert taken.units == [UnitFigures(1, 7)]
    for at in (0.0, NOW - LIVE_S - 1, NOW + 60):
        assert only(replace(figures, at=at)) == ("live", taken)


def test_only_the_frames_of_the_window_are_shown() -> None:
    frames = [Frame(at, "in", b"", []) for at in (NOW, 0.0, NOW + 60)]
    assert only(Frames(frames)) == ("live", Frames(frames[:1]))


def test_a_result_counts_and_its_impossible_times_do_not() -> None:
    outcome = UnitOutcome(1, "verified", sent_at=NOW - 1, acknowledged_at=NOW + 60, proven_at=0.0)
    frames = [Frame(at, "in", b"", []) for at in (NOW, 0.0)]
    values = [ParameterValue(unit, 3, at, 1) for unit, at in ((1, NOW), (1, 0.0), (9, NOW))]
    result = Result(
        "c", 0.0, "verified", units=[outcome, replace(outcome, unit=9)], values=values, frames=frames
    )
    assert only(result) == (
        "live",
        Result(
            "c",
            NOW,
            "verified",
            units=[replace(outcome, acknowledged_at=None, proven_at=None)],
            values=[values[0], replace(values[1], at=NOW)],
            frames=frames[:1],
        ),
    )
    assert only(Progress("c", 0.0, "sent")) == ("live", Progress("c", NOW, "sent"))


def test_a_snapshot_may_be_as_old_as_its_worker_and_not_from_the_future() -> None:
    old, ahead = NOW - 30 * 86_400, NOW + 60
    past = UnitState(1, UnitLink(1, old, "online"), replace(READING, at=old), [ParameterValue(1, 3, old, 1)])
    future = UnitState(
        2, UnitLink(2, ahead, "online"), Reading(2, ahead, 5, 5, 0, 0, 0), [ParameterValue(2, 3, ahead, 1)]
    )
    foreign = replace(past, unit=9)
    figures = BusFigures(ahead, 1.0, 1.0, 1.0, 1.0)
    snapshot = Snapshot(0, NOW, BusLink(ahead, "open"), [past, future, foreign], figures)
    assert judge_snapshot(snapshot, UNITS, NOW) == Snapshot(
        0,
        NOW,
        BusLink(NOW, "open"),
        [past, UnitState(2, UnitLink(2, NOW, "online"))],
        replace(figures, at=NOW),
    )


def test_a_unit_of_a_snapshot_holds_only_its_own() -> None:
    state = UnitState(
        1, UnitLink(2, NOW, "online"), Reading(2, NOW, 5, 5, 0, 0, 0), [ParameterValue(2, 3, NOW, 1)]
    )
    (judged,) = judge_snapshot(Snapshot(0, NOW, BusLink(NOW, "open"), [state]), UNITS, NOW).units
    assert judged == UnitState(1, UnitLink(1, NOW, "online"))


def test_the_parts_of_a_result_that_can_belong_to_its_command() -> None:
    values = [ParameterValue(unit, 3, NOW, 1) for unit in UNITS]
    frames = [Frame(NOW, "in", b"", [])] * 2_000
    result = Result("c", NOW, "verified", values=values, frames=frames)
    few = frames[: SetSpeed.most_frames]
    assert result_for(result, SetSpeed(1, 5)) == replace(result, values=[], frames=few)
    assert result_for(result, ReadParameters(2)) == replace(result, values=values[1:], frames=few)
    assert result_for(result, ReadTrace(0.0)) == replace(result, values=[])
