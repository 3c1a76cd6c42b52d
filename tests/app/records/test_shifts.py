"""Which shift a moment is in: also on the days on which the clocks change. Pure; under a second.

Which span a report is of, and when one is due; with the days on which the clocks change.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from itertools import islice, pairwise
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from app.records.handover.rules import (
    EVERYTHING,
    Scope,
    Shift,
    ShiftSettings,
    instant_of,
    shift_at,
    shifts_until,
    site_time,
)
from app.records.notification.settings import NotifySettings
from app.records.reports.rules import (
    LATE_S,
    MAX_DAYS,
    SETTLE_S,
    ReportEvery,
    ReportSettings,
    SpanName,
    last_due,
    named_span,
    refuse_unsendable,
    span_fault,
)
from bus.instants import UnixTime
from bus.settings import BusSettings

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


THREE_SHIFTS = (6 * 60, 14 * 60, 22 * 60)
DAY_S = 86_400.0


def berlin(text: str) -> UnixTime:
    return UnixTime(datetime.fromisoformat(text).replace(tzinfo=BERLIN).timestamp())


def written(span: Shift | None) -> str:
    assert span is not None
    return " ".join(
        datetime.fromtimestamp(float(each), BERLIN).strftime("%m-%d %H:%M") for each in (span.start, span.end)
    )


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("shift", "11-27 14:00 11-27 22:00"),
        ("last_shift", "11-27 06:00 11-27 14:00"),
        ("today", "11-27 00:00 11-28 00:00"),
        ("yesterday", "11-26 00:00 11-27 00:00"),
        ("week", "11-21 00:00 11-28 00:00"),
    ],
)
def test_the_spans_that_people_name(name: SpanName, expected: str) -> None:
    assert written(named_span(name, berlin("2026-11-27T15:00"), THREE_SHIFTS, BERLIN)) == expected


def test_a_day_on_which_the_clocks_change_is_a_day() -> None:
    day = named_span("today", berlin("2026-10-25T12:00"), THREE_SHIFTS, BERLIN)
    assert (written(day), day.end - day.start) == ("10-25 00:00 10-26 00:00", 25 * 3600)


@pytest.mark.parametrize(
    ("every", "now", "expected"),
    [
        ("shift", "2026-11-27T14:05", "11-27 06:00 11-27 14:00"),
        ("shift", "2026-11-27T14:04", "11-26 22:00 11-27 06:00"),
        ("day", "2026-11-27T07:00", "11-26 00:00 11-27 00:00"),
        ("day", "2026-10-26T07:00", "10-25 00:00 10-26 00:00"),
        ("week", "2026-11-23T07:00", "11-16 00:00 11-23 00:00"),
        ("week", "2026-03-30T07:00", "03-23 00:00 03-30 00:00"),
    ],
)
def test_the_report_that_is_due(every: ReportEvery, now: str, expected: str) -> None:
    assert written(last_due(every, 7 * 60, berlin(now), THREE_SHIFTS, BERLIN)) == expected


@pytest.mark.parametrize(
    ("every", "now"),
    [("day", "2026-11-27T06:59"), ("week", "2026-11-23T06:59"), ("week", "2026-11-27T07:00")],
)
def test_a_report_is_not_sent_before_its_time_or_long_after(every: ReportEvery, now: str) -> None:
    assert last_due(every, 7 * 60, berlin(now), THREE_SHIFTS, BERLIN) is None


@given(st.floats(1.7e9, 1.9e9), st.sampled_from(["shift", "day", "week"]), st.integers(0, 1439))
def test_a_span_that_is_due_is_over(now: float, every: ReportEvery, minute: int) -> None:
    span = last_due(every, minute, UnixTime(now), THREE_SHIFTS, BERLIN)
    if every == "shift":
        assert span is not None
        assert now - span.end >= SETTLE_S
    if span is not None:
        assert span.start < span.end <= now <= span.end + DAY_S + 3600 + LATE_S
        again = last_due(every, minute, UnixTime(now), THREE_SHIFTS, BERLIN)
        assert again == span


@pytest.mark.parametrize(
    ("days", "units", "code"),
    [
        (0, 1, "report_span_malformed"),
        (MAX_DAYS + 1, 1, "report_span_too_long"),
        (8, 255, "report_too_many_units"),
        (7, 255, ""),
        (MAX_DAYS, 8, ""),
    ],
)
def test_a_span_that_there_is_no_report_of(days: int, units: int, code: str) -> None:
    now = berlin("2026-11-27T12:00")
    fault = span_fault(Shift(UnixTime(now - days * DAY_S), now), now, units)
    assert (fault.code if fault else "") == code


def test_a_span_of_the_future_and_one_before_the_epoch_have_no_report() -> None:
    now = berlin("2026-11-27T12:00")
    later = Shift(now + 60.0, now + 120.0)
    for span in (later, Shift(UnixTime(-5.0), UnixTime(5.0))):
        fault = span_fault(span, now, 1)
        assert fault is not None
        assert fault.code == "report_span_malformed"
    assert timedelta(days=MAX_DAYS) > timedelta(days=31), "any month has a report"


@pytest.mark.parametrize(
    ("scope", "held", "concerned"),
    [
        (EVERYTHING, "site wet dry dry/1 dry/2", "site wet dry dry/1 dry/2"),
        (Scope("dry"), "dry dry/1 dry/2", "site dry dry/1 dry/2"),
        (Scope("dry", 1), "dry/1", "site dry dry/1"),
    ],
)
def test_what_a_line_and_a_unit_hold_and_have_to_know(scope: Scope, held: str, concerned: str) -> None:
    places: dict[str, tuple[str | None, int | None]] = {
        "site": (None, None),
        "wet": ("wet", None),
        "dry": ("dry", None),
        "dry/1": ("dry", 1),
        "dry/2": ("dry", 2),
    }
    assert " ".join(name for name, place in places.items() if scope.holds(*place)) == held
    assert " ".join(name for name, place in places.items() if scope.concerns(*place)) == concerned


def test_a_scope_is_a_condition_of_sql() -> None:
    assert EVERYTHING.conditions() == ("", [])
    assert Scope("dry").conditions() == (" AND bus = ?", ["dry"])
    assert Scope("dry", 1).conditions("e.") == (" AND e.bus = ? AND e.unit = ?", ["dry", 1])


def test_a_start_of_a_shift_is_given_once() -> None:
    assert ShiftSettings(starts=("06:00", "18:00")).minutes == [360, 1080]
    with pytest.raises(ValidationError) as refused:
        ShiftSettings(starts=("06:00", "18:00", "06:00"))
    assert [each["loc"] for each in refused.value.errors()] == [("starts",)]


@pytest.mark.parametrize(
    ("report", "host", "fault"),
    [
        ({"bus": "dry-end", "unit": 1}, "mail", ""),
        ({"bus": "wet-end"}, "mail", "setting_notify_bus"),
        ({"bus": "dry-end", "unit": 9}, "mail", "setting_report_unit"),
        ({}, "", "setting_mail_server_missing"),
    ],
)
def test_a_report_that_could_not_be_sent_is_refused(report: dict[str, object], host: str, fault: str) -> None:
    wanted = ReportSettings.model_validate({"every": "day", "at": "06:30", "to": ["a@plant"], **report})
    assert wanted.minute == 390
    smtp = {"smtp": {"host": host, "sender": "lineside@plant"}} if host else {}
    notify = NotifySettings.model_validate(smtp)
    unit = {"id": 1, "name": "Unwind"}
    bus = BusSettings.model_validate({"name": "dry-end", "port": "/dev/null", "unit": [unit]})
    if not fault:
        refuse_unsendable([wanted], notify, [bus])
        return
    with pytest.raises(PydanticCustomError) as refused:
        refuse_unsendable([wanted], notify, [bus])
    assert fault in repr(refused.value.context)
