"""The rules of detection, each by hand: limits, rates, counters, suppression, first-out, priority."""

from __future__ import annotations

from decimal import Decimal
from itertools import product
from typing import get_args

import pytest

from app.line.alarms.rules import (
    ChangeRate,
    CountWindow,
    FirstOut,
    LimitRule,
    Suppressors,
    is_at_rest,
    limits_of,
)
from app.line.conditions.catalogue import CONDITIONS
from app.line.conditions.condition import (
    MATRIX,
    PRIORITIES,
    Consequence,
    SuppressionGroup,
    TimeToRespond,
    Tuning,
)
from bus.instants import UnixTime


@pytest.mark.parametrize(
    ("value", "active", "holds"),
    [(100, False, False), (101, False, True), (99, True, True), (98, True, False), (49, False, True)],
)
def test_a_limit_is_passed_at_once_and_left_by_the_deadband(value: int, active: bool, holds: bool) -> None:
    assert LimitRule(above=100, below=50, deadband=2).holds(value, active) is holds


def test_below_a_limit_the_deadband_is_above_it() -> None:
    rule = LimitRule(above=None, below=50, deadband=2)
    assert [rule.holds(value, active=True) for value in (49, 51, 52)] == [True, True, False]


def test_a_rate_needs_a_second_and_begins_again_after_a_gap() -> None:
    rate = ChangeRate()
    assert [rate.see(value, at) for value, at in ((0, 0), (50, 0.5), (30, 1.0))] == [None, None, 30.0]
    assert rate.see(0, 0.2) == 30.0
    rate.forget()
    assert rate.see(500, 5.0) is None


def test_counters_are_judged_by_the_minute_and_may_begin_again_at_zero() -> None:
    window = CountWindow()
    for total, faults, at in ((100, 5, 0), (400, 8, 30)):
        window.see(total, faults, UnixTime(at))
    assert (window.total, window.faults) == (None, None)
    window.see(700, 9, UnixTime(60))
    assert (window.total, window.faults) == (600, 4)
    window.see(10, 0, UnixTime(90))
    window.see(60, 1, UnixTime(150))
    assert (window.total, window.faults) == (50, 1)
    window.see(90, 30, UnixTime(200))
    window.restart()
    for total, faults, at in ((100, 40, 210), (200, 42, 269), (300, 43, 270)):
        assert (window.total, window.faults) == (50, 1)
        window.see(total, faults, UnixTime(at))
    assert (window.total, window.faults) == (200, 3)


@pytest.mark.parametrize(
    ("suppressors", "suppressed"),
    [
        (Suppressors(), ""),
        (Suppressors(CONDITIONS["worker_lost"].suppresses), "bus cable unit speed"),
        (Suppressors(CONDITIONS["port_lost"].suppresses), "cable unit speed"),
        (Suppressors(CONDITIONS["no_unit_responds"].suppresses), "unit speed"),
        (Suppressors(at_rest=True), "speed"),
        (Suppressors(estops={1}), "speed"),
        (Suppressors(estops={2}), ""),
    ],
)
def test_each_cause_suppresses_its_groups_of_alarms(suppressors: Suppressors, suppressed: str) -> None:
    assert [group for group in get_args(SuppressionGroup) if suppressors.suppress(group, 1)] == (
        suppressed.split()
    )
    assert not suppressors.suppress(None, 1)


def test_a_line_is_at_rest_when_zero_is_commanded_to_every_unit() -> None:
    assert is_at_rest([0, 0])
    assert not is_at_rest([0, 1])
    assert not is_at_rest([0, None])
    assert not is_at_rest([])


def test_the_first_alarm_of_a_disturbance_is_named_and_one_alone_is_not() -> None:
    first_out = FirstOut()
    rises = (("a", 0), ("b", 5), ("a", 5), ("c", 5.1), ("d", 6), ("e", 2))
    assert [first_out.rise(alarm, UnixTime(at)) for alarm, at in rises] == [None, "a", None, None, "c", None]


def test_the_matrix_is_complete_and_higher_is_never_less_urgent() -> None:
    consequences, times = get_args(Consequence), get_args(TimeToRespond)
    assert set(MATRIX) == set(product(consequences, times))
    for consequence in consequences:
        ranks = [PRIORITIES.index(MATRIX[consequence, time]) for time in times]
        assert ranks == sorted(ranks)


def test_limits_in_percent_are_in_counts_of_the_full_scale_and_never_zero() -> None:
    tuning = Tuning(above_percent=Decimal(5), below_percent=Decimal(1), deadband_percent=Decimal("0.5"))
    assert limits_of(tuning, 2000) == LimitRule(above=100, below=20, deadband=10)
    assert limits_of(Tuning(above_percent=Decimal(5)), 4) == LimitRule(above=1, below=None, deadband=0)


def test_counts_are_judged_once_there_is_a_minute_of_them() -> None:
    window = CountWindow()
    assert window.judged(lambda *_: True) is None
    window.see(0, 0, UnixTime(0))
    window.see(60, 3, UnixTime(60))
    assert window.judged(lambda total, faults: (total, faults) == (60, 3)) is True
