"""Duty rosters against a second model, which fills in a week minute by minute."""

from __future__ import annotations

from datetime import datetime, timedelta

from hypothesis import given
from hypothesis import strategies as st

from app.records.notification.rules.roster import DutyPeriod, DutyRoster, minute_of_week

MONDAY = datetime(2026, 11, 23)
DAY = 1440
periods = st.builds(
    DutyPeriod,
    st.frozensets(st.integers(0, 6), min_size=1),
    st.integers(0, DAY - 1),
    st.integers(1, DAY),
    st.lists(st.sampled_from("abc"), min_size=1, max_size=2).map(tuple),
)


def filled_in(roster: DutyRoster) -> list[set[str]]:
    """The addresses on duty in each minute of a week."""
    week: list[set[str]] = [set() for _ in range(7 * DAY)]
    for period in roster.periods:
        for day in period.days:
            for minute in range(period.minutes):
                week[(day * DAY + period.starts + minute) % len(week)] |= set(period.to)
    return week


@given(st.lists(periods, max_size=3), st.integers(0, 7 * DAY - 1))
def test_people_on_duty_equal_a_week_filled_in(several: list[DutyPeriod], minute: int) -> None:
    roster = DutyRoster(periods=tuple(several))
    week = filled_in(roster)
    local = MONDAY + timedelta(minutes=minute)
    assert minute_of_week(local) == minute
    assert set(roster.on_duty(local)) == (week[minute] or set(roster.addresses()))


@given(st.lists(periods, min_size=1, max_size=3))
def test_gaps_are_the_minutes_that_have_no_one(several: list[DutyPeriod]) -> None:
    roster = DutyRoster(periods=tuple(several))
    in_gaps = {minute for first, end in roster.gaps() for minute in range(first, end)}
    assert in_gaps == {minute for minute, present in enumerate(filled_in(roster)) if not present}
    assert DutyRoster(("always",), roster.periods).gaps() == []
