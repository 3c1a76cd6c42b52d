"""The checks before a command is sent: ranges, limits, what is refused, and what counts as slower."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.arrival import DEFAULT_TIMEOUT_S
from app.errors import Problem
from app.line.commands.catalogue import check, longest_change_s, timeout_s_for
from app.line.commands.limits import HIGHEST_SETPOINT, NO_LIMITS, CommandBlock, Limits
from app.line.commands.rules import (
    Moves,
    RuleContext,
    SetpointRange,
    parameter_bounds,
    reason_of,
    setpoint_parameter,
    setpoint_range,
    slows_all,
    unread_for_range,
)
from app.line.live.bus_live import BusLive, LiveState, UnitLive
from bus.catalogue.parameters import PARAMETERS
from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ParameterValue,
    ReadParameters,
    SetLine,
    SetSpeed,
    Staged,
    UnitLink,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.instants import Monotonic
from bus.messages import Message
from tests.app.fake_worker import HEALTHY, bus_settings, reading
from tests.app.played_commands import a_bus, responding

RUNNING = HEALTHY | 1
BLOCK = CommandBlock("belt off, do not run", "anna", 0.0)


def bus_with(*updates: Update, **settings: object) -> BusLive:
    """The three units, after these updates."""
    live = LiveState([bus_settings(**settings)], time.time())
    live.buses["dry-end"].apply(updates)
    return live.buses["dry-end"]


def parameter(unit: int, number: int, raw: int) -> ParameterValue:
    """A value that was read."""
    return ParameterValue(unit=unit, number=number, at=time.time(), raw=raw)


def circumstances(
    bus: BusLive | None = None,
    *,
    limits: Limits = NO_LIMITS,
    blocked: int = 0,
    moved: int = 0,
    confirm: bool = False,
) -> RuleContext:
    """Unit 1 has these limits, unit ``blocked`` is blocked."""
    return RuleContext(
        bus=bus or bus_with(reading(1), reading(2), reading(16)),
        limits=lambda unit: limits if unit == 1 else NO_LIMITS,
        block=lambda unit: BLOCK if unit == blocked else None,
        moved=lambda unit: moved if unit == 1 else 0,
        confirm=confirm,
    )


def objection(action: Action, now: RuleContext) -> Problem:
    """The objection there must be."""
    with pytest.raises(Problem) as caught:
        check(action, now)
    return caught.value


def nearest_of(problem: Problem) -> int | None:
    """The value that the refusal offers."""
    return problem.extra.get("nearest")


setpoints = st.integers(-(2**40), 2**40)
bounds = st.integers(0, HIGHEST_SETPOINT)


@given(setpoints)
def test_what_the_link_can_carry_passes_and_nothing_else(raw: int) -> None:
    if 0 <= raw <= HIGHEST_SETPOINT:
        check(SetSpeed(unit=1, raw=raw), circumstances())
    else:
        error = objection(SetSpeed(unit=1, raw=raw), circumstances())
        assert error.code == "invalid"
        assert nearest_of(error) == (0 if raw < 0 else HIGHEST_SETPOINT)


@given(setpoints, bounds, bounds)
def test_the_nearest_that_is_offered_would_be_allowed(raw: int, one: int, other: int) -> None:
    now = circumstances(limits=Limits(lowest=min(one, other), highest=max(one, other)))
    if raw == 0 or min(one, other) <= raw <= max(one, other):
        check(SetSpeed(unit=1, raw=raw), now)
        return
    nearest = nearest_of(objection(SetSpeed(unit=1, raw=raw), now))
    assert nearest is not None
    check(SetSpeed(unit=1, raw=nearest), now)


@given(bounds, st.booleans())
def test_limits_hold_on_every_path_to_a_setpoint(raw: int, execute: bool) -> None:
    limits = Limits(lowest=500, highest=600)
    staged = circumstances(bus_with(reading(1), Staged(unit=1, at=0.0, raw=raw)), limits=limits)
    paths: list[tuple[Action, RuleContext]] = [
        (SetSpeed(unit=1, raw=raw, execute=execute), circumstances(limits=limits)),
        (SetLine(setpoints={1: raw, 2: 5}), circumstances(limits=limits)),
        (WriteParameter(unit=1, number=20, raw=raw), circumstances(limits=limits)),
        (ExecuteSpeed(unit=1), staged),
        (ExecuteAll(), staged),
    ]
    for action, now in paths:
        if raw == 0 or 500 <= raw <= 600:
            check(action, now)
        else:
            assert objection(action, now).code == "invalid"


@given(bounds, bounds)
def test_a_large_step_needs_a_review(raw: int, largest: int) -> None:
    limits = Limits(largest_step=largest)
    if raw == 0 or abs(raw - 1000) <= largest:
        check(SetSpeed(unit=1, raw=raw), circumstances(limits=limits))
    else:
        assert objection(SetSpeed(unit=1, raw=raw), circumstances(limits=limits)).code == "confirm_needed"
        check(SetSpeed(unit=1, raw=raw), circumstances(limits=limits, confirm=True))


def test_a_step_from_a_speed_that_was_never_read_needs_a_review() -> None:
    now = circumstances(bus_with(), limits=Limits(largest_step=99999))
    assert objection(SetSpeed(unit=1, raw=5), now).code == "confirm_needed"


def test_the_movement_within_a_minute_is_limited_over_all_confirmations() -> None:
    limits = Limits(per_minute=100)
    check(SetSpeed(unit=1, raw=1040), circumstances(limits=limits, moved=60))
    error = objection(SetSpeed(unit=1, raw=1041), circumstances(limits=limits, moved=60, confirm=True))
    assert error.code == "invalid"
    assert "40 remains" in str(error)


def test_a_follower_takes_a_ratio_between_its_own_limits() -> None:
    bus = bus_with(reading(1), parameter(1, 8, 1), parameter(1, 38, 5000), parameter(1, 31, 15000))
    check(SetSpeed(unit=1, raw=10000), circumstances(bus))
    assert nearest_of(objection(SetSpeed(unit=1, raw=4999), circumstances(bus))) == 5000
    assert nearest_of(objection(SetSpeed(unit=1, raw=15001), circumstances(bus))) == 15000
    assert nearest_of(objection(SetSpeed(unit=1, raw=0), circumstances(bus))) == 5000


WRITES: list[Action] = [
    SetSpeed(unit=2, raw=5),
    SetSpeed(unit=2, raw=5, execute=False),
    ExecuteSpeed(unit=2),
    SetLine(setpoints={1: 5, 2: 5}),
    WriteOutput(unit=2, number=1, on=True),
    WriteAnalogOutput(unit=2, raw=5),
    WriteParameter(unit=2, number=6, raw=50),
    ChangeBaud(baud=4800),
]


@pytest.mark.parametrize("action", WRITES, ids=lambda action: type(action).__name__)
def test_a_blocked_unit_is_refused_on_every_path(action: Action) -> None:
    error = objection(action, circumstances(blocked=2, confirm=True))
    assert error.code == "blocked"
    assert "anna" in str(error)
    assert BLOCK.reason in str(error)
    check(action, circumstances(blocked=16 if not isinstance(action, ChangeBaud) else 0, confirm=True))


def test_a_broadcast_is_refused_when_it_would_execute_what_a_blocked_unit_has_staged() -> None:
    bus = bus_with(reading(1), Staged(unit=2, at=0.0, raw=5))
    assert objection(ExecuteAll(), circumstances(bus, blocked=2)).code == "blocked"
    assert objection(SetLine(setpoints={1: 5}), circumstances(bus, blocked=2)).code == "blocked"
    check(ExecuteAll(), circumstances(bus, blocked=1))


def test_reading_a_blocked_unit_is_no_write() -> None:
    check(ReadParameters(unit=2), circumstances(blocked=2))


def test_the_reason_of_a_refusal_stands_without_the_words_that_nothing_was_sent() -> None:
    refused = objection(SetLine(setpoints={}), circumstances())
    assert reason_of(refused) == Message("setpoints_missing")
    assert reason_of(Problem(503, "not_sent", Message("deadline_passed"))) == Message("deadline_passed")


@given(st.integers(-5, 12))
def test_outputs_are_one_to_six(number: int) -> None:
    action = WriteOutput(unit=1, number=number, on=True)
    if 1 <= number <= 6:
        check(action, circumstances())
    else:
        assert objection(action, circumstances()).code == "invalid"


@given(st.integers(-10, 3000))
def test_the_analog_output_stays_between_29_and_30_where_they_are_known(raw: int) -> None:
    action = WriteAnalogOutput(unit=1, raw=raw)
    known = circumstances(bus_with(parameter(1, 29, 100), parameter(1, 30, 2000)))
    if 100 <= raw <= 2000:
        check(action, known)
    else:
        assert nearest_of(objection(action, known)) == (100 if raw < 100 else 2000)
    if raw >= 0:
        check(action, circumstances())


@given(st.sampled_from(sorted(PARAMETERS)), st.integers(-(2**33), 2**33))
def test_a_parameter_out_of_range_never_leaves(number: int, raw: int) -> None:
    row = PARAMETERS[number]
    action = WriteParameter(unit=1, number=number, raw=raw)
    legal = row.minimum <= raw <= row.maximum and (row.allowed is None or raw in row.allowed)
    if legal and not row.never_writable:
        check(action, circumstances(confirm=True))
    else:
        assert objection(action, circumstances(confirm=True)).code == "invalid"


@pytest.mark.parametrize(("number", "raw"), [(18, 48), (19, 0), (19, 2), (27, 1)])
def test_what_can_cut_the_link_off_needs_a_confirmation(number: int, raw: int) -> None:
    action = WriteParameter(unit=1, number=number, raw=raw)
    assert objection(action, circumstances()).code == "dangerous"
    check(action, circumstances(confirm=True))


def test_remote_is_no_danger() -> None:
    check(WriteParameter(unit=1, number=19, raw=1), circumstances())


def test_the_mode_is_not_changed_while_running() -> None:
    action = WriteParameter(unit=1, number=8, raw=1)
    running = circumstances(bus_with(reading(1, inputs=RUNNING)))
    assert objection(action, running).code == "invalid"
    check(action, circumstances())


def test_a_baud_that_no_unit_speaks_is_refused_with_the_nearest() -> None:
    assert nearest_of(objection(ChangeBaud(baud=5000), circumstances())) == 4800
    assert objection(ChangeBaud(baud=4800), circumstances()).code == "dangerous"


def test_a_parameter_that_no_unit_has_is_refused() -> None:
    error = objection(WriteParameter(unit=1, number=41, raw=1), circumstances(confirm=True))
    assert (error.code, str(error)) == ("invalid", "a unit has the parameters 1 to 40; nothing was sent")


def test_a_unit_that_was_never_read_is_not_taken_for_running() -> None:
    [number, *_] = [row.number for row in PARAMETERS.values() if row.not_while_running]
    action = WriteParameter(unit=1, number=number, raw=PARAMETERS[number].minimum)
    check(action, circumstances(bus_with(), confirm=True))


# --- how far a setpoint was moved within a minute ------------------------------------------------


@pytest.fixture
def moves() -> Moves:
    """Unit 1 was moved by 30 at second 100, and by 12 at second 130."""
    noted = Moves()
    noted.note({1: 30}, Monotonic(100.0))
    noted.note({1: 12}, Monotonic(130.0))
    return noted


@pytest.mark.parametrize(("at", "moved"), [(159.9, 42), (160.0, 12), (189.9, 12), (190.0, 0)])
def test_a_step_counts_for_a_minute(moves: Moves, at: float, moved: int) -> None:
    assert moves.within_a_minute(1, Monotonic(at)) == moved
    assert moves.within_a_minute(2, Monotonic(at)) == 0


def test_a_step_that_did_not_happen_counts_no_more(moves: Moves) -> None:
    moves.take_back({1: 30}, Monotonic(100.0))
    assert moves.within_a_minute(1, Monotonic(130.0)) == 12


def test_only_the_step_that_was_noted_is_taken_back(moves: Moves) -> None:
    moves.take_back({1: 30}, Monotonic(130.0))
    moves.take_back({2: 30}, Monotonic(100.0))
    assert moves.within_a_minute(1, Monotonic(130.0)) == 42


def test_limits_that_were_typed_for_another_display_are_refused_but_for_speed_zero() -> None:
    bus = bus_with(parameter(1, 3, 1), parameter(1, 8, 0))
    for decimals in (None, 1):
        check(SetSpeed(1, 1100), circumstances(bus, limits=Limits(highest=1500, decimals=decimals)))
    other = circumstances(bus, limits=Limits(highest=1500, decimals=0))
    check(SetSpeed(1, 0), other)
    with pytest.raises(Problem, match="since its limits were set"):
        check(SetSpeed(1, 1100), other)
    check(SetSpeed(1, 1100), circumstances(bus, limits=Limits(decimals=0)))


def test_a_change_of_several_units_may_wait_for_its_stages_and_be_withdrawn_from_each() -> None:
    bus = bus_with()
    slow = bus_with(baud=300)
    assert timeout_s_for(bus) == timeout_s_for(slow) == DEFAULT_TIMEOUT_S
    assert timeout_s_for(bus) < timeout_s_for(bus, 3) < timeout_s_for(slow, 3)
    assert timeout_s_for(bus, 3) < timeout_s_for(bus, 3, typed=True)
    assert longest_change_s(bus, 3) == 3 * timeout_s_for(bus, 3, typed=True)


@pytest.fixture
def at_1000() -> BusLive:
    """Two units at 1000."""
    live = a_bus()
    responding(live)
    return live.buses["dry-end"]


@pytest.mark.parametrize(
    ("setpoints", "slower"),
    [
        ({1: 0}, True),
        ({1: 999}, True),
        ({1: 1000}, False),
        ({1: 1001}, False),
        ({1: 900, 2: 0}, True),
        ({1: 900, 2: 1001}, False),
    ],
)
def test_each_unit_has_to_become_slower(at_1000: BusLive, setpoints: dict[int, int], slower: bool) -> None:
    assert slows_all(setpoints, at_1000) is slower


def test_of_a_unit_that_is_not_known_now_only_zero_counts(at_1000: BusLive) -> None:
    at_1000.apply([UnitLink(unit=1, at=2.0, link="stale")])
    assert slows_all({1: 0}, at_1000)
    assert not slows_all({1: 1}, at_1000)


@pytest.mark.parametrize("raw", [0, 1, 999])
def test_a_ratio_of_a_follower_never_counts(at_1000: BusLive, raw: int) -> None:
    at_1000.apply([ParameterValue(unit=1, number=8, at=2.0, raw=1)])
    assert not slows_all({1: raw}, at_1000)
    assert not slows_all({1: raw, 2: 0}, at_1000)


FOLLOWER = {8: 1, 31: 15000, 38: 5000}


def unit(parameters: dict[int, int | None]) -> UnitLive:
    """A unit of which this was read; None: it does not have it (NAK 82h)."""
    live = a_bus()
    live.buses["dry-end"].apply(
        [
            ParameterValue(unit=1, number=number, at=1.0, raw=raw, available=raw is not None)
            for number, raw in parameters.items()
        ]
    )
    return live.buses["dry-end"].units[1]


@pytest.mark.parametrize(
    ("parameters", "limits", "expected"),
    [
        ({8: 0, 2: 2000}, NO_LIMITS, SetpointRange("speed", 0, 2000, "display")),
        ({8: 0, 2: 2000}, Limits(highest=2500), SetpointRange("speed", 0, 2500, "limits")),
        ({8: 0, 2: 2000}, Limits(lowest=100, highest=1500), SetpointRange("speed", 100, 1500, "limits")),
        ({8: 0, 2: 2000}, Limits(lowest=2500), SetpointRange("speed", 2000, 2000, "limits")),
        ({8: 0, 2: 0}, NO_LIMITS, SetpointRange("speed", 0, 99999, "protocol")),
        ({8: 0, 2: 4_000_000}, NO_LIMITS, SetpointRange("speed", 0, 99999, "protocol")),
        ({8: None, 2: 2000}, NO_LIMITS, SetpointRange("speed", 0, 2000, "display")),
        ({**FOLLOWER, 2: 2000}, NO_LIMITS, SetpointRange("ratio", 5000, 15000, "ratio")),
        (FOLLOWER, Limits(lowest=8000, highest=9000), SetpointRange("ratio", 8000, 9000, "limits")),
        (FOLLOWER, Limits(lowest=20000), SetpointRange("ratio", 15000, 15000, "limits")),
        (FOLLOWER, Limits(highest=3000), SetpointRange("ratio", 5000, 5000, "limits")),
        ({8: 1, 31: 79999, 38: 99999}, NO_LIMITS, SetpointRange("ratio", 99999, 99999, "ratio")),
        ({8: 1, 31: None, 38: None}, NO_LIMITS, SetpointRange("ratio", 0, 99999, "protocol")),
    ],
)
def test_the_range(parameters: dict[int, int | None], limits: Limits, expected: SetpointRange) -> None:
    assert setpoint_range(unit(parameters), limits) == expected


def test_the_setpoint_that_is_not_the_unit_s_own_is_bounded_by_the_unit_alone() -> None:
    """#37 of a master, #20 of a follower."""
    limits = Limits(lowest=8000, highest=9000)
    master = unit({**FOLLOWER, 8: 0, 2: 2000})
    follower = unit({**FOLLOWER, 2: 2000})
    assert parameter_bounds(master, 37, limits) == (5000, 15000)
    assert parameter_bounds(master, 20, limits) == (8000, 9000)
    assert parameter_bounds(follower, 20, limits) == (0, 2000)
    assert parameter_bounds(follower, 37, limits) == (8000, 9000)
    assert parameter_bounds(master, 6, limits) == (0, 9999)


@pytest.mark.parametrize(
    ("known", "limits", "raw", "unread"),
    [
        ({}, NO_LIMITS, 5, (8, 2)),
        ({8: 0}, NO_LIMITS, 5, (2,)),
        ({8: 0, 2: None}, NO_LIMITS, 5, ()),
        ({8: 0}, Limits(highest=5), 5, ()),
        ({8: 0}, Limits(lowest=5), 5, (2,)),
        ({8: 1}, Limits(highest=5), 5, (31, 38)),
        ({8: 1, 31: 5}, NO_LIMITS, 0, (38,)),
        ({}, NO_LIMITS, 0, ()),
    ],
)
def test_what_has_to_be_read_first(
    known: dict[int, int | None], limits: Limits, raw: int, unread: tuple[int, ...]
) -> None:
    assert unread_for_range(unit(known), limits, raw) == unread


IN_PRESET, IN_UP, IN_DOWN, IN_FOLLOWER = (1 << bit for bit in (2, 4, 5, 6))
ON = reading(1).inputs


@pytest.mark.parametrize(
    ("inputs", "follower_speed", "expected"),
    [
        (ON, "ratio", None),
        (ON | IN_PRESET, "ratio", 20),
        (ON | IN_UP, "speed", 20),
        (ON | IN_DOWN, "ratio", 20),
        (ON | IN_FOLLOWER, "ratio", None),
        (ON | IN_FOLLOWER | IN_PRESET, "ratio", 37),
        (ON | IN_FOLLOWER, "speed", 37),
    ],
)
def test_a_setpoint_that_the_status_does_not_show_is_in_a_parameter(
    inputs: int, follower_speed: str, expected: int | None
) -> None:
    bus = bus_with(reading(1, inputs=inputs), follower_speed=follower_speed)
    assert setpoint_parameter(bus.units[1], bus) == expected
    assert setpoint_parameter(bus.units[2], bus) is None, "it was never read"
