"""Which updates of a worker are taken in, on time and late, and what the manual rules out is no value
anywhere."""

from __future__ import annotations

import time
from typing import Any

import pytest
from msgspec.structs import replace

from app.core.database import Database
from app.line.feed.plausibility import (
    AHEAD_S,
    FIRST_S,
    LIVE_S,
    OFFSET_ERROR_S,
    REPEATED_S,
    Coverage,
    LateReadings,
    LateWindow,
    believed_reading,
    judge_snapshot,
    result_for,
    sort_updates,
)
from app.line.live.api.view import parameter_json
from app.line.live.fields import unit_fields
from bus.contract import (
    BUFFER_AGE_S,
    MAX_UPDATES,
    Batch,
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
from tests.app.alarm_bus import HEALTHY, REMOTE, RUN, AlarmBus
from tests.app.complete_app import House
from tests.app.conftest import Kept
from tests.app.fake_worker import reading, snapshot, unit_state, until
from tests.app.screens import line as screen_line
from tests.app.screens import reading as seen_reading
from tests.app.screens import translator

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


MOMENT = 2_000_000.0
LATE_READING = Reading(1, MOMENT, 5, 5, 0, 0, 0)
OF_ALL_KINDS = [
    LATE_READING,
    ParameterValue(1, 3, MOMENT, 1),
    UnitLink(1, MOMENT, "offline"),
    BusLink(MOMENT, "closed"),
]


def window() -> LateWindow:
    """Of a worker that connects now, ten minutes after its bus was last followed."""
    return Coverage(MOMENT - 600).window(MOMENT)


@pytest.mark.parametrize("update", OF_ALL_KINDS, ids=lambda update: type(update).__name__)
@pytest.mark.parametrize(
    ("age_s", "is_taken"),
    [
        (7 * 86_400.0, False),
        (600.0, False),
        (599.9, True),
        (300.0, True),
        (0.0, True),
        (-OFFSET_ERROR_S - 0.1, False),
    ],
)
def test_only_the_time_without_a_worker_is_taken(update: Update, age_s: float, is_taken: bool) -> None:
    late = window()
    assert late.admits(replace(update, at=MOMENT - age_s), 0.0, late.until) is is_taken


@pytest.mark.parametrize(("age_s", "is_repeated"), [(599.9, False), (600.0, True), (600 + REPEATED_S, False)])
def test_what_was_not_confirmed_before_a_crash_is_sent_again(age_s: float, is_repeated: bool) -> None:
    assert window().is_repeated(replace(LATE_READING, at=MOMENT - age_s)) is is_repeated
    assert not window().is_repeated(BusFigures(MOMENT - age_s, 1.0, 1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("age_s", "is_known"), [(599.9, False), (600.0, True), (659.9, True), (660.0, False)]
)
def test_a_live_reading_of_the_time_before_the_connection(age_s: float, is_known: bool) -> None:
    """One of much earlier is by a clock that was set back."""
    assert window().is_known(replace(LATE_READING, at=MOMENT - age_s)) is is_known
    assert not window().is_known(UnitLink(1, MOMENT - age_s, "offline"))


def test_what_history_does_not_keep_is_not_judged() -> None:
    assert window().admits(BusFigures(0.0, 1.0, 1.0, 1.0, 1.0), 0.0, MOMENT)


def test_readings_of_a_unit_are_taken_in_their_order_and_once() -> None:
    late = window()
    given = [(1, -500.0), (1, -499.0), (1, -499.0), (1, -499.5), (2, -499.5), (1, -498.0)]
    taken = [late.admits(replace(LATE_READING, unit=unit, at=MOMENT + at), 0.0, MOMENT) for unit, at in given]
    assert taken == [True, True, False, False, True, True]


def test_the_order_is_that_of_the_workers_clock() -> None:
    """Its offset is estimated better with each message: a later reading then has an earlier time."""
    late = window()
    assert late.admits(replace(LATE_READING, at=MOMENT - 500 + 0.3), 0.3, MOMENT)
    assert late.admits(replace(LATE_READING, at=MOMENT - 500 + 0.1), 0.0, MOMENT)


def test_a_first_worker_is_believed_as_far_as_it_keeps_anything() -> None:
    first = Coverage().window(MOMENT)
    assert (first.since, first.until) == (MOMENT - FIRST_S, MOMENT + OFFSET_ERROR_S)


def batch(*at: float, live: bool = True, sent_at: float = MOMENT) -> Batch:
    return Batch(1, sent_at, [replace(LATE_READING, at=each) for each in at], live=live)


@pytest.mark.parametrize(
    ("received", "until"),
    [
        (batch(), MOMENT),
        (batch(MOMENT - 1), MOMENT),
        (batch(sent_at=MOMENT + 3600), MOMENT),
        (batch(MOMENT - 300, MOMENT - 299, live=False), MOMENT - 299),
        (batch(live=False), MOMENT - 600),
        (batch(MOMENT - 700, live=False), MOMENT - 600),
        (batch(*[MOMENT - 30] * MAX_UPDATES), MOMENT - 30),
    ],
    ids=["nothing new", "live", "ahead", "late", "late, nothing taken", "before", "full"],
)
def test_how_far_a_bus_is_followed_by_a_batch(received: Batch, until: float) -> None:
    coverage = Coverage(MOMENT - 600)
    coverage.advance(received, received.updates, MOMENT)
    assert coverage.until == until


def test_a_backlog_alone_shows_nothing_of_a_bus_that_is_not_known() -> None:
    coverage = Coverage()
    coverage.advance(batch(live=False), [], MOMENT)
    assert coverage.until is None


def test_a_connection_that_ends_in_its_backlog_goes_on_where_it_ended() -> None:
    coverage = Coverage(MOMENT - 600)
    part = batch(MOMENT - 600, MOMENT - 400, live=False)
    coverage.advance(part, part.updates, MOMENT)
    assert coverage.window(MOMENT + 60).since == MOMENT - 400


def test_a_clock_that_was_set_back_refuses_the_time_before_and_not_all_that_follows() -> None:
    coverage = Coverage(MOMENT)
    assert coverage.window(MOMENT - 3600).since == MOMENT - 3600
    assert coverage.window(MOMENT - 3000).since == MOMENT - 3600


def test_late_readings_are_counted_with_their_span() -> None:
    late = LateReadings()
    late.add([UnitLink(1, MOMENT - 90, "offline")])
    assert late == LateReadings()
    for ages in ((60, 50), (40, 30)):
        late.add([replace(LATE_READING, at=MOMENT - age) for age in ages])
    assert late == LateReadings(4, MOMENT - 60, MOMENT - 30)


NEGATIVE = 4_294_967_196
"""-100 as the two's complement of four bytes."""
BEYOND = (100_000, NEGATIVE)
SPEEDS = ("commanded", "actual")


@pytest.mark.parametrize("field", SPEEDS)
@pytest.mark.parametrize("raw", BEYOND)
def test_a_speed_beyond_the_manual_is_none_with_what_the_unit_sent(field: str, raw: int) -> None:
    sent: dict[str, Any] = {"commanded": 528, "actual": 4099, "analog": 7, "outputs": 0xC1, "inputs": 0x03}
    found = believed_reading(Reading(unit=1, at=time.time(), **sent | {field: raw}))  # type: ignore[arg-type]
    speeds = b"".join((sent | {field: raw})[name].to_bytes(4, "big") for name in SPEEDS)
    assert getattr(found, field) is None
    assert found.deviation is None
    assert found.implausible == speeds + b"\x07\xc1\x03"
    assert (found.analog, found.outputs, found.inputs) == (7, 0xC1, 0x03)


def test_the_ends_of_the_range_are_taken_as_they_are() -> None:
    for raw in (0, 99_999):
        found = reading(1, raw, actual=raw)
        assert believed_reading(found) is found


def test_in_a_snapshot_too() -> None:
    state = unit_state(1)
    state = type(state)(1, state.link, reading(1, actual=NEGATIVE))
    [judged] = judge_snapshot(snapshot(units=[state]), (1,), time.time()).units  # type: ignore[arg-type]
    assert judged.reading is not None
    assert judged.reading.actual is None


async def test_it_is_shown_so_and_neither_stored_nor_counted(site: House, kept: Kept) -> None:
    worker = await site.worker()
    await worker.update(reading(1, 900, actual=900), reading(2, 900, actual=900))
    await until(lambda: len(kept.readings) == 2, "the first readings")
    await worker.update(reading(1, 900, actual=NEGATIVE), reading(2, 901, actual=901))
    await until(lambda: len(kept.readings) == 4, "the reading of unit 2")
    assert [each.actual for each in kept.readings] == [900, 900, None, 901]
    unit = (await site.http().get("/api/v1/buses/dry-end/units/1")).json()
    shown = ("commanded_raw", "actual_raw", "actual", "deviation_raw", "deviation", "rpm", "draw")
    assert [unit[name] for name in shown] == [900, None, None, None, None, None, None]
    assert unit["implausible"].startswith("00 00 03 84 FF FF FF 9C ")
    assert unit["inputs"] is not None
    assert unit["link"] == "online"
    await worker.update(reading(1, 900, actual=902))
    await until(lambda: len(kept.readings) == 5, "the next reading")
    assert (await site.http().get("/api/v1/buses/dry-end/units/1")).json()["implausible"] is None


def test_a_page_has_it_in_words() -> None:
    live = screen_line()
    live.buses["dry"].apply([believed_reading(seen_reading(1, actual=NEGATIVE))])
    bus = live.buses["dry"]
    fields = unit_fields(bus, bus.units[1], "online", translator())
    assert (fields["actual"], fields["fill"], fields["off"], fields["state"]) == ("implausible", "", "", "")
    assert fields["commanded"] != "implausible"


@pytest.fixture
def bus(database: Database) -> AlarmBus:
    found = AlarmBus(database)
    found.connect()
    found.wait(2, 1, 2, 3)
    return found


def test_it_is_one_alarm_with_its_bytes(bus: AlarmBus) -> None:
    parameter = ParameterValue(1, 2, bus.now, 100_000)  # type: ignore[arg-type]
    sent = Reading(1, bus.now, 1000, NEGATIVE, 51, REMOTE, RUN | HEALTHY)  # type: ignore[arg-type]
    bus.wait(1, 1, 2, 3, actual=None, implausible=believed_reading(sent).implausible)
    bus.apply(parameter)
    assert bus.present() == {"1.value_implausible", "2.value_implausible", "3.value_implausible"}
    present = str(bus.alarms.present(bus.alarm("1.value_implausible")))
    assert "00 00 03 E8 FF FF FF 9C 33 40 03" in present
    assert "Maximum Display Value (parameter 2): 100000" in present
    bus.wait(10, 1, 2, 3)
    assert bus.state("1.value_implausible") == "unack_active", "the parameter still is"
    assert bus.state("2.value_implausible") == "rtn_unack"
    bus.apply(replace(parameter, raw=20_000))
    bus.wait(10, 1, 2, 3)
    assert bus.state("1.value_implausible") == "rtn_unack"


OUTSIDE = [(1, 65_536), (2, NEGATIVE), (3, 5), (8, 3), (23, 1000), (31, 80_000)]


@pytest.mark.parametrize(("number", "raw"), OUTSIDE)
def test_a_parameter_scales_and_bounds_nothing(bus: AlarmBus, number: int, raw: int) -> None:
    bus.apply(ParameterValue(1, number, bus.now, raw))  # type: ignore[arg-type]
    unit = bus.live.units[1]
    assert unit.parameter_raw(number) is None
    shown = parameter_json(unit, number)
    assert (shown["raw"], shown["value"], shown["implausible"]) == (raw, None, True)


async def test_a_parameter_is_not_stored_as_a_scale(site: House, kept: Kept) -> None:
    worker = await site.worker()
    await worker.update(
        ParameterValue(1, 3, time.time(), 7),  # type: ignore[arg-type]
        ParameterValue(1, 2, time.time(), 2000),  # type: ignore[arg-type]
    )
    await until(lambda: any(isinstance(each, ParameterValue) for each in kept), "#2")
    assert 7 not in [each.raw for each in kept if isinstance(each, ParameterValue)]
