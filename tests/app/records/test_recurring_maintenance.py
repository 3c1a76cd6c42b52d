"""Maintenance that recurs: by the clock of the site, also when it changes; on the page and the API."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.admission.access import Role
from app.people.audit.log import EventLog
from app.records.notification.maintenance import Maintenance
from app.records.notification.rules.recurring import first_at, recurring_spans
from app.records.notification.service import Notification
from app.records.notification.settings import (
    DAYS,
    DayOfWeek,
    MaintenanceSettings,
    NotifySettings,
    SmtpSettings,
)
from app.settings import load
from bus.instants import UnixTime, unix_now
from tests.app.complete_app import complete_app
from tests.app.configured import faults_of
from tests.app.played_line import BUS, played_line

BERLIN = ZoneInfo("Europe/Berlin")
ZONES = st.sampled_from(
    [BERLIN, *map(ZoneInfo, ("UTC", "America/New_York", "Australia/Lord_Howe", "Pacific/Apia"))]
)
CHANGES = {"spring": date(2027, 3, 28), "autumn": date(2026, 10, 25)}
TABLE = '[[notify.maintenance]]\nstarts = "22:00"\nends = "02:00"\nuntil = 2027-03-31\nreason = "felt wash"\n'


def window(starts: str, ends: str, *days: DayOfWeek, until: date = date(2099, 1, 1)) -> MaintenanceSettings:
    return MaintenanceSettings(days=days or DAYS, starts=starts, ends=ends, until=until, reason="wash")


def shown(recurring: MaintenanceSettings, first: date, last: date) -> list[tuple[str, str]]:
    return [(utc(span.starts), utc(span.ends)) for span in recurring_spans(recurring, first, last, BERLIN)]


def utc(at: UnixTime) -> str:
    return datetime.fromtimestamp(at, UTC).strftime("%d. %H:%M")


@pytest.mark.parametrize(
    ("change", "starts", "ends", "spans"),
    [
        ("spring", "01:00", "04:00", [("28. 00:00", "28. 02:00")]),
        ("spring", "02:30", "04:00", [("28. 01:00", "28. 02:00")]),
        ("spring", "01:30", "02:30", [("28. 00:30", "28. 01:00")]),
        ("spring", "02:10", "02:50", []),
        ("autumn", "01:00", "04:00", [("24. 23:00", "25. 03:00")]),
        ("autumn", "02:15", "02:45", [("25. 00:15", "25. 00:45")]),
        ("autumn", "02:30", "03:30", [("25. 00:30", "25. 02:30")]),
        ("autumn", "22:00", "02:30", [("25. 21:00", "26. 01:30")]),
    ],
)
def test_on_a_night_on_which_the_clocks_change(
    change: str, starts: str, ends: str, spans: list[tuple[str, str]]
) -> None:
    day = CHANGES[change]
    assert shown(window(starts, ends), day, day) == spans


def test_over_the_changes_it_ends_by_the_clock_of_the_next_day() -> None:
    spring, autumn = (CHANGES[each] - timedelta(days=1) for each in ("spring", "autumn"))
    assert shown(window("22:00", "06:00"), spring, spring) == [("27. 21:00", "28. 04:00")]
    assert shown(window("22:00", "06:00"), autumn, autumn) == [("24. 20:00", "25. 05:00")]
    assert shown(window("00:00", "00:00"), CHANGES["spring"], CHANGES["spring"]) == [
        ("27. 23:00", "28. 22:00")
    ]


def test_it_begins_on_its_days_up_to_the_last() -> None:
    monday = date(2026, 11, 23)
    found = shown(
        window("06:00", "07:00", "mon", "wed", until=date(2026, 11, 30)), monday, monday + timedelta(days=30)
    )
    assert [start for start, _ in found] == ["23. 05:00", "25. 05:00", "30. 05:00"]
    over_midnight = window("22:00", "02:00", "mon", until=monday)
    assert shown(over_midnight, monday, monday + timedelta(days=7)) == [("23. 21:00", "24. 01:00")]
    assert shown(window("06:00", "07:00", until=date(2020, 1, 1)), monday, monday) == []


@given(ZONES, st.dates(date(1990, 1, 1), date(2037, 12, 31)), st.integers(0, 1439))
def test_no_earlier_moment_shows_the_clock_or_has_passed_it(
    zone: ZoneInfo, day: date, at_minute: int
) -> None:
    found = first_at(day, at_minute, zone)
    wanted = datetime.combine(day, datetime.min.time()) + timedelta(minutes=at_minute)

    def clock(at: float) -> datetime:
        return datetime.fromtimestamp(at, zone).replace(tzinfo=None)

    assert clock(found) >= wanted
    assert all(clock(found - 60 * minutes) < wanted for minutes in (1, 15, 30, 59, 60, 61))


def test_the_configuration_is_read_and_its_faults_are_named(tmp_path: Path) -> None:
    bus = f'[[bus]]\nname = "{BUS}"\nport = "/dev/null"\n'
    assert faults_of(tmp_path, bus + TABLE) == ""
    (recurring,) = load(tmp_path / "lineside.toml").notify.maintenance
    assert (recurring.starts, recurring.until, recurring.buses) == ("22:00", date(2027, 3, 31), ())
    for wrong, words in (
        ('until = "2027-03-31"', "a day without quotes"),
        ("until = 2027-03-31T06:00:00", "a day without quotes"),
        ('buses = ["wet"]', "no bus wet"),
        ("days = []", "days"),
    ):
        key = wrong.partition(" ")[0]
        kept = "".join(each + "\n" for each in TABLE.splitlines() if not each.startswith(key))
        fault = faults_of(tmp_path, bus + kept + wrong + "\n")
        assert words in fault, fault
        assert fault.startswith("FILE:")
    assert "until" in faults_of(tmp_path, bus + TABLE.replace("until = 2027-03-31\n", ""))


def settings(*, days_ahead: int) -> NotifySettings:
    """All the day, on the day so many days from now, in any zone."""
    day = datetime.now(BERLIN) + timedelta(days=days_ahead)
    recurring = MaintenanceSettings(
        days=tuple(DAYS[(day.weekday() + more) % 7] for more in (-1, 0)),
        starts="00:00",
        ends="00:00",
        until=day.date(),
        reason="felt <wash>",
        buses=(BUS,),
    )
    smtp = SmtpSettings(host="mail.invalid", sender="lineside@plant", to=("duty@plant",))
    return NotifySettings(smtp=smtp, maintenance=(recurring,))


@pytest.mark.parametrize(("days_ahead", "is_present"), [(0, True), (3, False)])
async def test_nothing_is_notified_in_it_and_the_page_and_the_api_show_it(
    tmp_path: Path, days_ahead: int, is_present: bool
) -> None:
    async with complete_app(
        tmp_path, notify=settings(days_ahead=days_ahead), time_zone="Europe/Berlin"
    ) as house:
        await played_line(house.services)
        engineer = await house.signed_in(Role.ENGINEER)
        (found,) = (await engineer.get("/api/v1/notifications")).json()["recurring"]
        assert (found["present"], found["buses"], found["starts"]) == (is_present, [BUS], "00:00")
        assert (datetime.fromisoformat(found["since"]) <= datetime.now(UTC)) is is_present
        for language, words in (
            ("en", "Recurring maintenance (dry-end): nothing is notified until"),
            ("de", "Wiederkehrende Wartung (dry-end): bis"),
        ):
            page = await engineer.get("/notifications", headers={"Accept-Language": language})
            assert (words in page.text) is is_present
            assert "felt &lt;wash&gt;" in page.text
        spans = house.services[Notification].maintenance.spans()
        assert any(span.covers(BUS, unix_now()) for span in spans) is is_present
        assert not any(span.covers(None, unix_now()) for span in spans)


async def test_its_spans_follow_the_day(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        notification = house.services[Notification]
        now = UnixTime(first_at(date(2026, 11, 23), 12 * 60, BERLIN))
        daily = window("22:00", "02:00", until=date(2026, 11, 24))
        clock = [now]
        maintenance = Maintenance(
            notification.store, house.services[EventLog], [daily], BERLIN, [BUS], lambda: clock[0]
        )
        covered = []
        for hour in range(0, 72, 6):
            clock[0] = UnixTime(now + 3600.0 * hour)
            covered.append(any(span.covers(BUS, clock[0]) for span in maintenance.spans()))
        assert [hour for hour, each in zip(range(0, 72, 6), covered, strict=True) if each] == [12, 36]
        assert [(each.since, each.until) for each in maintenance.recurring()] == [(None, None)]
