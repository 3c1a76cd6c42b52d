"""Which shift a moment is in: also on the days on which the clocks change. Pure; under a second."""

from __future__ import annotations

from datetime import datetime
from itertools import islice, pairwise
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.records.handover.rules.shift_times import Shift, instant_of, shift_at, shifts_until, site_time
from bus.instants import UnixTime

BERLIN = ZoneInfo("Europe/Berlin")
THREE = (360, 840, 1320)
ZONES = st.sampled_from(
    [BERLIN, *map(ZoneInfo, ("UTC", "America/New_York", "Australia/Lord_Howe", "Pacific/Apia"))]
)
STARTS = st.lists(st.integers(0, 1439), min_size=1, max_size=24, unique=True)
MOMENTS = st.floats(0, 4e9).map(UnixTime)


def at(text: str) -> UnixTime:
    return UnixTime(datetime.fromisoformat(text).timestamp())


def hours(shift: Shift) -> float:
    return (shift.end - shift.start) / 3600


@pytest.mark.parametrize(
    ("moment", "start", "lasts"),
    [
        ("2026-11-23T06:00:00+01:00", "2026-11-23T06:00:00+01:00", 8),
        ("2026-11-23T13:59:59.999+01:00", "2026-11-23T06:00:00+01:00", 8),
        ("2026-11-23T05:59:59+01:00", "2026-11-22T22:00:00+01:00", 8),
        ("2026-03-29T01:00:00+01:00", "2026-03-28T22:00:00+01:00", 7),
        ("2026-10-25T02:30:00+01:00", "2026-10-24T22:00:00+02:00", 9),
    ],
)
def test_a_shift_lasts_to_the_next_start_and_an_hour_less_or_more_where_the_clocks_change(
    moment: str, start: str, lasts: float
) -> None:
    shift = shift_at(at(moment), THREE, BERLIN)
    assert (shift.start, hours(shift)) == (at(start), lasts)


def test_a_start_that_the_clocks_skip_is_where_they_go_on() -> None:
    shift = shift_at(at("2026-03-29T03:00:00+02:00"), (150, 840), BERLIN)
    assert shift.start == at("2026-03-28T14:00:00+01:00")
    assert shift.end == at("2026-03-29T03:30:00+02:00")


@given(moment=MOMENTS, starts=STARTS, zone=ZONES)
def test_every_moment_is_in_one_shift_and_shifts_follow_each_other(
    moment: UnixTime, starts: list[int], zone: ZoneInfo
) -> None:
    shift = shift_at(moment, starts, zone)
    assert shift.holds(moment)
    assert shift_at(shift.start, starts, zone) == shift
    assert shift_at(shift.end, starts, zone).start == shift.end
    recent = list(islice(shifts_until(moment, starts, zone), 30))
    assert recent[0] == shift
    assert all(earlier.end == later.start for later, earlier in pairwise(recent))


@given(moment=MOMENTS, minute=st.integers(0, 1439), starts=STARTS, zone=ZONES)
def test_a_clock_names_a_moment_of_the_shift_or_none(
    moment: UnixTime, minute: int, starts: list[int], zone: ZoneInfo
) -> None:
    shift = shift_at(moment, starts, zone)
    found = instant_of(minute, shift, zone)
    shows = {
        60 * local.hour + local.minute
        for local in (
            datetime.fromtimestamp(float(shift.start) + 60 * n, zone)
            for n in range(round((shift.end - shift.start) / 60))
        )
    }
    assert (found is not None) is (minute in shows)
    if found is not None:
        assert shift.holds(found)


def test_of_an_hour_that_comes_twice_the_first_is_meant() -> None:
    shift = shift_at(at("2026-10-25T01:00:00+02:00"), THREE, BERLIN)
    assert instant_of(150, shift, BERLIN) == at("2026-10-25T02:30:00+02:00")
    spring = shift_at(at("2026-03-29T01:00:00+01:00"), THREE, BERLIN)
    assert instant_of(150, spring, BERLIN) is None


def test_a_message_names_a_moment_by_the_clock_of_the_site() -> None:
    assert site_time(at("2026-10-25T02:30:00+02:00"), BERLIN) == "2026-10-25 02:30"
