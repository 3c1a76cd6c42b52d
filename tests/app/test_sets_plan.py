"""What a restore writes, in which order, and what it leaves out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from app.sets.model import Row, UnitRows
from app.sets.plan import plan_restore
from bus.catalogue.parameters import PARAMETERS


def rows(values: dict[int, int | None], **marks: bool) -> UnitRows:
    available = marks.get("available", True)
    return UnitRows(1, "Nip", {number: Row(number, raw, available, 1.0) for number, raw in values.items()})


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
    ticked = plan_restore(rows(dict(wanted)), rows(dict(present)), running=False, ticked=frozenset({19}))
    assert [write.number for write in ticked.writes][-1] == 19
    assert 17 not in {write.number for write in ticked.writes}


bounds = st.tuples(st.integers(0, 999), st.integers(0, 999)).map(sorted)


@given(present=bounds, wanted=bounds)
def test_no_step_on_the_way_has_a_low_end_above_its_high_end(present: list[int], wanted: list[int]) -> None:
    now = every({22: present[0], 23: present[1]})
    plan = plan_restore(rows(every({22: wanted[0], 23: wanted[1]})), rows(now), running=False)
    for write in plan.writes:
        now[write.number] = write.wanted
        low, high = now[22], now[23]
        assert low is not None
        assert high is not None
        assert low <= high


def test_a_maximum_comes_before_what_it_bounds() -> None:
    wanted = every({2: 5000, 8: 1, 9: 4000, 20: 4500, 31: 30000, 37: 20000, 38: 5000, 4: 10000})
    order = [write.number for write in plan_restore(rows(wanted), rows(every()), running=False).writes]
    assert order.index(2) < order.index(9) < order.index(20)
    assert order.index(31) < order.index(4) < order.index(37)
    assert order.index(38) < order.index(37)
    assert order.index(8) < order.index(37)


def test_the_mode_waits_for_run_to_go_off_and_unknown_counts_as_running() -> None:
    wanted, present = rows(every({8: 1})), rows(every())
    for running in (True, None):
        plan = plan_restore(wanted, present, running=running)
        assert [left.number for left in plan.left_out] == [8]
        assert "Run" in plan.left_out[0].reason
    assert [write.number for write in plan_restore(wanted, present, running=False).writes] == [8]


def test_setup_during_run_is_allowed_first_and_forbidden_late() -> None:
    opened = plan_restore(rows(every({16: 1, 6: 50})), rows(every()), running=False)
    assert [write.number for write in opened.writes] == [16, 6]
    closed = plan_restore(rows(every({6: 50})), rows(every({16: 1})), running=False)
    assert [write.number for write in closed.writes] == [6, 16]


def test_what_a_unit_does_not_have_and_what_the_set_does_not_hold_is_named() -> None:
    present = UnitRows(1, "Nip", {6: Row(6, 10), 40: Row(40, None, available=False)})
    plan = plan_restore(rows({6: 50, 40: 1, 21: None}), present, running=False)
    reasons = {left.number: left.reason for left in plan.left_out}
    assert [write.number for write in plan.writes] == [6]
    assert "does not have" in reasons[40]
    assert "secret" in reasons[21]


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
        assert "REMOTE" in plan.left_out[0].reason
    told_by_status = plan_restore(wanted, local, running=False, remote=True)
    assert 6 in {write.number for write in told_by_status.writes}


def test_a_value_that_no_unit_takes_is_named_and_not_sent() -> None:
    plan = plan_restore(rows(every({18: 7})), rows(every({18: 96})), running=False, ticked=frozenset({18}))
    assert plan.writes == ()
    assert "it takes 3, 6, 12, 24, 48 or 96" in plan.left_out[0].reason
