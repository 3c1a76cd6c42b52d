"""The plan of a restore: what it writes and leaves out, and an order without a step worse than its ends."""

from __future__ import annotations

import re
from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engineering.sets.model import ParameterRow, UnitRows
from app.engineering.sets.restore_plan import (
    INVERSE_FOLLOWER,
    MAY_RUN,
    RUNS,
    Selection,
    Write,
    in_order,
    plan_restore,
    refuse_unwritable,
    remarks,
)
from app.errors import Problem
from app.line.commands.effects import NO_RAMP, OPERATING_VALUES, warning_of
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message


def rows(values: dict[int, int | None], **marks: bool) -> UnitRows:
    available = marks.get("available", True)
    return UnitRows(
        1, "Nip", {number: ParameterRow(number, raw, available, 1.0) for number, raw in values.items()}
    )


def every(raw_of: dict[int, int] | None = None) -> dict[int, int | None]:
    given = {19: 1} | (raw_of or {})
    return {number: given.get(number, row.minimum) for number, row in PARAMETERS.items()}


raws = st.fixed_dictionaries(
    {number: st.integers(row.minimum, row.maximum) for number, row in PARAMETERS.items()}
)


@given(wanted=raws, present=raws, running=st.sampled_from([True, False, None]))
def test_every_row_is_equal_written_or_named(
    wanted: dict[int, int], present: dict[int, int], running: bool | None
) -> None:
    plan = plan_restore(rows(dict(wanted)), rows(dict(present)), running=running)
    named = {left.number for left in plan.left_out}
    written = [write.number for write in plan.writes]
    assert len(written) == len(set(written))
    assert not named & set(written)
    assert plan.equal + len(named) + len(written) == len(PARAMETERS)
    assert all(write.wanted == wanted[write.number] != present[write.number] for write in plan.writes)
    assert all(left.reason for left in plan.left_out)


@given(wanted=raws, present=raws)
def test_the_address_is_never_written_and_danger_only_when_ticked(
    wanted: dict[int, int], present: dict[int, int]
) -> None:
    wanted[19], present[19] = 0, 1
    wanted[27], present[27] = 1, 0
    plan = plan_restore(rows(dict(wanted)), rows(dict(present)), running=False)
    assert not {17, 19, 27} & {write.number for write in plan.writes}
    confirmed = Selection(confirmed=frozenset({19}))
    ticked = plan_restore(rows(dict(wanted)), rows(dict(present)), running=False, selection=confirmed)
    assert [write.number for write in ticked.writes][-1] == 19
    assert 17 not in {write.number for write in ticked.writes}


@given(wanted=raws, present=raws, running=st.sampled_from([True, False, None]))
def test_a_setpoint_is_written_only_when_it_was_chosen(
    wanted: dict[int, int], present: dict[int, int], running: bool | None
) -> None:
    now, then = rows(dict(present)), rows(dict(wanted) | {20: (present[20] + 1) % 99999, 37: present[37] ^ 1})
    plan = plan_restore(then, now, running=running)
    assert not OPERATING_VALUES & {write.number for write in plan.writes}
    named = {left.number: left.reason for left in plan.left_out}
    assert (named[20], named[37]) == ("operating_value", "operating_value")
    chosen = plan_restore(then, now, running=running, selection=Selection(include=frozenset({20})))
    if present[19] == 1:
        assert {write.number for write in chosen.writes} - {write.number for write in plan.writes} == {20}


@given(numbers=st.frozensets(st.sampled_from(sorted(PARAMETERS))), present=raws, wanted=raws)
def test_every_row_can_be_deselected(
    numbers: frozenset[int], present: dict[int, int], wanted: dict[int, int]
) -> None:
    now, then = rows(dict(present) | {19: 1}), rows(dict(wanted) | {19: 1})
    plan = plan_restore(then, now, running=False, selection=Selection(exclude=numbers))
    written = {write.number for write in plan.writes}
    assert written == {write.number for write in plan_restore(then, now, running=False).writes} - numbers
    left_out = {left.number: left.reason for left in plan.left_out}
    assert all(
        left_out[number] in ("deselected", "address", "illegal_value") for number in numbers & left_out.keys()
    )


@pytest.mark.parametrize(
    ("number", "running", "status", "code", "error"),
    [
        (17, False, 422, "invalid", "17) cannot be written: the address is set at the keypad only"),
        (8, True, 422, "invalid", "8) cannot be written: no change while the run input is on"),
        (18, False, 409, "dangerous", "18): The unit responds only at the new baud rate"),
    ],
)
def test_a_named_row_is_never_left_out_without_notice(
    number: int, running: bool, status: int, code: str, error: str
) -> None:
    wanted, selection = rows(every({17: 5, 8: 1, 18: 96})), Selection(include=frozenset({number}))
    plan = plan_restore(wanted, rows(every({18: 48})), running=running, selection=selection)
    with pytest.raises(Problem, match=re.escape(error)) as refused:
        refuse_unwritable(plan, selection)
    assert (refused.value.status, refused.value.code) == (status, code)


def test_a_row_cannot_be_named_and_excluded() -> None:
    with pytest.raises(Problem, match=r"Speed Setpoint \(parameter 20\) is both included and excluded"):
        Selection(include=frozenset({20}), exclude=frozenset({20}))


def test_a_change_of_a_running_machine_is_announced() -> None:
    for number in (1, 2, 4, 5, 6, 7, 9, 20, 31, 33, 37, 38):
        assert warning_of(number, 5, running=True)
        assert warning_of(number, 5, running=None) == warning_of(number, 5, running=True)
    assert not any(warning_of(number, 5, running=True) for number in (12, 15, 17, 21, 39))
    assert not any(warning_of(number, 5, running=False) for number in PARAMETERS if number not in (20, 37))
    assert warning_of(20, 5, running=False) == Message("effect_setpoint")
    ramp, window = ({number: 50} for number in (6, 12))
    for running, values, expected in (
        (True, ramp, [RUNS]),
        (None, ramp, [MAY_RUN]),
        (False, ramp, []),
        (True, window, []),
    ):
        wanted, present = rows(every(values)), rows(every())
        writes = plan_restore(wanted, present, running=running).writes
        assert remarks(wanted, present, running=running, writes=writes) == expected


@pytest.mark.parametrize("number", [6, 7])
@pytest.mark.parametrize("running", [True, None, False])
def test_a_ramp_of_nothing_is_warned_of_at_a_standstill_too(number: int, running: bool | None) -> None:
    assert warning_of(number, 0, running=running) == NO_RAMP


def test_the_mode_waits_for_run_to_go_off_and_unknown_counts_as_running() -> None:
    wanted, present = rows(every({8: 1})), rows(every())
    for running in (True, None):
        plan = plan_restore(wanted, present, running=running)
        assert [(left.number, left.reason) for left in plan.left_out] == [(8, "running")]
    assert [write.number for write in plan_restore(wanted, present, running=False).writes] == [8]


def test_setup_during_run_is_allowed_first_and_forbidden_late() -> None:
    opened = plan_restore(rows(every({16: 1, 6: 50})), rows(every()), running=False)
    assert [write.number for write in opened.writes] == [16, 6]
    closed = plan_restore(rows(every({6: 50})), rows(every({16: 1})), running=False)
    assert [write.number for write in closed.writes] == [6, 16]


def test_what_a_unit_does_not_have_and_what_the_set_does_not_hold_is_named() -> None:
    present = UnitRows(1, "Nip", {6: ParameterRow(6, 10), 40: ParameterRow(40, None, available=False)})
    plan = plan_restore(rows({6: 50, 40: 1, 21: None}), present, running=False)
    reasons = {left.number: (left.reason, left.text) for left in plan.left_out}
    assert [write.number for write in plan.writes] == [6]
    assert reasons[40] == ("not_in_unit", Message("row_not_in_unit"))
    assert reasons[21] == ("secret", Message("row_secret"))


def test_local_is_named_beforehand_and_may_be_written_later() -> None:
    wanted, local = rows(every({6: 5, 17: 3})), rows(every({6: 9, 19: 0}))
    for plan in (
        plan_restore(wanted, local, running=False),
        plan_restore(wanted, rows(every({6: 9})), running=False, remote=False),
    ):
        assert plan.writes == ()
        assert {left.number: left.later for left in plan.left_out} | {19: True} == {
            6: True,
            17: False,
            19: True,
        }
        assert plan.left_out[0].text == Message("row_not_in_remote")
    reported_by_status = plan_restore(wanted, local, running=False, remote=True)
    assert 6 in {write.number for write in reported_by_status.writes}


def test_a_value_that_no_unit_takes_is_named_and_not_sent() -> None:
    confirmed = Selection(confirmed=frozenset({18}))
    plan = plan_restore(rows(every({18: 7})), rows(every({18: 96})), running=False, selection=confirmed)
    assert plan.writes == ()
    assert plan.left_out[0].reason == "illegal_value"
    assert "it takes 3, 6, 12, 24, 48 or 96" in str(plan.left_out[0].text)


MASTER, FOLLOWER = 0, 1
Values = dict[int, int]
positive = st.integers(1, 9999)


def steps(present: Values, wanted: Values, mode: int | None = MASTER) -> list[Values]:
    """What the unit holds before, after each write, and at the end."""
    writes = [Write(number, present[number], raw) for number, raw in wanted.items() if raw != present[number]]
    ordered = in_order(writes, mode=mode)
    return list(accumulate(ordered, lambda now, row: now | {row.number: row.wanted}, initial=present))


def order(present: Values, wanted: Values, mode: int | None = MASTER) -> list[int]:
    writes = (Write(number, present[number], wanted[number]) for number in wanted)
    return [write.number for write in in_order(writes, mode=mode)]


def speed(values: Values) -> float:
    """Motor speed of a running master: setpoint * #1 / #2, by the pulses of #5 (protocol.md, 3)."""
    return values[20] * values[1] / values[2] * values[5]


scaling = st.fixed_dictionaries(dict.fromkeys((1, 2, 5, 20), positive))


@given(present=scaling, wanted=scaling)
def test_a_running_master_is_never_faster_than_before_or_afterwards(present: Values, wanted: Values) -> None:
    way = [speed(values) for values in steps(present, wanted)]
    assert max(way) <= max(way[0], way[-1]) * (1 + 1e-9)


def ratio(values: Values, mode: int) -> float:
    """Speed of a follower for one of its master: base ratio * ratio, or divided by it."""
    return values[4] / values[37] if mode == INVERSE_FOLLOWER else values[4] * values[37]


ratios = st.fixed_dictionaries(dict.fromkeys((4, 37), positive))


@given(present=ratios, wanted=ratios, mode=st.sampled_from([FOLLOWER, INVERSE_FOLLOWER]))
def test_a_running_follower_is_never_faster_than_before_or_afterwards(
    present: Values, wanted: Values, mode: int
) -> None:
    way = [ratio(values, mode) for values in steps(present, wanted, mode)]
    assert max(way) <= max(way[0], way[-1]) * (1 + 1e-9)


bounded = st.tuples(positive, positive, positive).map(sorted)


@given(present=bounded, wanted=bounded, mode=st.sampled_from([MASTER, FOLLOWER, INVERSE_FOLLOWER, None]))
def test_a_value_is_within_its_bounds_after_every_write(
    present: list[int], wanted: list[int], mode: int | None
) -> None:
    for low, value, high in ((38, 37, 31), (38, 4, 31)):
        numbers = (low, value, high)
        for now in steps(
            dict(zip(numbers, present, strict=True)), dict(zip(numbers, wanted, strict=True)), mode
        ):
            assert now[low] <= now[value] <= now[high]
    for value in (9, 20):
        now_and_then = ({value: one[1], 2: one[2]} for one in (present, wanted))
        assert all(values[value] <= values[2] for values in steps(*now_and_then, mode))


ends = st.tuples(positive, positive).map(sorted)


@given(present=ends, wanted=ends)
def test_no_step_on_the_way_has_a_low_end_above_its_high_end(present: list[int], wanted: list[int]) -> None:
    for pair in ((22, 23), (29, 30)):
        now, then = (dict(zip(pair, given, strict=True)) for given in (present, wanted))
        assert all(values[pair[0]] <= values[pair[1]] for values in steps(now, then))


def test_the_meaning_comes_first_and_what_ends_the_talk_last() -> None:
    present = dict.fromkeys((3, 8, 6, 9, 16, 18, 19, 21, 27), 0)
    wanted = dict.fromkeys(present, 1)
    assert order(present, wanted) == [16, 3, 8, 6, 9, 21, 27, 18, 19]
    assert order(present | {16: 1}, wanted | {16: 0}) == [3, 8, 6, 9, 16, 21, 27, 18, 19]


@given(numbers=st.permutations([1, 2, 3, 4, 5, 6, 8, 9, 16, 20, 21, 31, 37, 38]))
def test_every_row_is_written_once_in_the_defined_order(numbers: list[int]) -> None:
    ordered = order(dict.fromkeys(numbers, 5), dict.fromkeys(numbers, 9))
    assert sorted(ordered) == sorted(numbers)
    assert ordered == order(dict.fromkeys(sorted(numbers), 5), dict.fromkeys(sorted(numbers), 9))
