"""What a restore writes, in which order, and what it leaves out."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engineering.sets.model import ParameterRow, UnitRows
from app.engineering.sets.restore_plan import (
    MAY_RUN,
    NO_RAMP,
    OPERATING_VALUES,
    RUNS,
    Selection,
    plan_restore,
    refuse_unwritable,
    remarks,
    warning_of,
)
from app.errors import Problem
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
        (
            17,
            False,
            422,
            "invalid",
            "Unit ID Number (parameter 17) cannot be written: the address is set at the keypad only",
        ),
        (
            8,
            True,
            422,
            "invalid",
            "Master/Slave/Inverse Mode (parameter 8) cannot be written: no change while the run input is on",
        ),
        (
            18,
            False,
            409,
            "dangerous",
            "Baud Rate (parameter 18): The unit responds only at the new baud rate",
        ),
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
