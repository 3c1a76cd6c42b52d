"""The rules of notification: what is notified to whom and when, against a second model that looks at each
second; rosters and recurring maintenance, against the clock minute by minute; and which message of an address
is next."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.web.access import Role
from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules import AlarmState, AlarmTrigger
from app.people.audit.log import EventLog
from app.records.notification.rules import (
    GIVE_UP_S,
    LATE_S,
    MAX_RETRY_S,
    DeliveryTurn,
    DutyPeriod,
    DutyRoster,
    EndpointLoad,
    Episode,
    NotificationPlan,
    NotificationRule,
    QuietSpan,
    Retry,
    due_at,
    first_at,
    follow,
    heartbeat_due,
    minute_of_week,
    next_turn,
    recurring_spans,
    retry_after_s,
    state_after_failure,
)
from app.records.notification.service import Maintenance, Notification
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

LOCAL = datetime(2026, 11, 22, 12)


def entry(
    id: int,
    trigger: AlarmTrigger,
    before: AlarmState,
    after: AlarmState,
    at: float = 1000.0,
    occurrence: int = 1,
) -> JournalEntry:
    return JournalEntry(
        "b.1.x", "x", "X", "b", 1, occurrence, "high", UnixTime(at), trigger, before, after, id=id
    )


def rule(
    *to: str, after_s: float = 0.0, priority: str = "high", buses: Sequence[str] = ()
) -> NotificationRule:
    return NotificationRule([priority], buses, after_s, DutyRoster(to))  # type: ignore[list-item]


RISE = entry(1, "rise", "normal", "unack_active")
RULES = [rule("anna"), rule("chief", after_s=600)]


def followed(
    entries: Sequence[JournalEntry], now: float, rules: Sequence[NotificationRule] = (), **more: object
):  # type: ignore[no-untyped-def]
    return follow(
        more.get("episodes", {}),
        entries,
        rules or RULES,
        more.get("quiet", []),
        UnixTime(now),
        LOCAL,  # type: ignore[arg-type]
    )


def test_a_clock_that_was_set_back_does_not_put_off_an_escalation() -> None:
    """By an hour, 100 s after the alarm: the chief is notified within the time of his rule from then on."""
    opened = followed([RISE], 1100).open
    set_back = followed([], 1100 - 3600, episodes=opened).open
    assert followed([], 1100 - 3600 + 599, episodes=set_back).notices == []
    found = followed([], 1100 - 3600 + 600, episodes=set_back).notices
    assert [each.endpoint for each in found] == ["chief"]


def to(done) -> list[tuple[str, float]]:  # type: ignore[no-untyped-def]
    return [(notice.endpoint, notice.after_s) for notice in done.notices]


def test_an_alarm_is_notified_once_and_escalated_while_no_one_acknowledges() -> None:
    first = followed([RISE], 1001)
    assert to(first) == [("anna", 0.0)]
    assert to(followed([], 1599, episodes=first.open)) == []
    second = followed([], 1600, episodes=first.open)
    assert to(second) == [("chief", 600.0)]
    assert to(followed([], 9999, episodes=second.open)) == []


def test_an_acknowledgement_ends_the_escalation() -> None:
    first = followed([RISE], 1001)
    done = followed([entry(2, "acknowledge", "unack_active", "ack_active")], 1700, episodes=first.open)
    assert (to(done), done.open) == ([], {})


def test_an_alarm_that_came_and_went_is_notified_and_cleared() -> None:
    done = followed([RISE, entry(2, "clear", "unack_active", "rtn_unack")], 1001)
    assert (to(done), [each.id for each in done.cleared], done.open) == ([("anna", 0.0)], [2], {})


def test_a_latched_alarm_is_escalated_after_its_condition_has_ended() -> None:
    done = followed([RISE, entry(2, "clear", "unack_active", "latched_unack")], 1001)
    assert to(followed([], 1600, episodes=done.open)) == [("chief", 600.0)]


def test_a_hidden_alarm_is_not_notified_and_one_that_comes_back_is() -> None:
    hidden = entry(1, "rise", "shelved", "shelved")
    assert to(followed([hidden], 1001)) == []
    assert to(followed([hidden, entry(2, "unshelve", "shelved", "unack_active")], 1001)) == [("anna", 0.0)]


def test_rules_choose_by_priority_and_bus() -> None:
    assert to(followed([RISE], 1001, [rule("a", priority="low"), rule("b", buses=["other"])])) == []
    assert to(followed([RISE], 1001, [rule("a", buses=["b"])])) == [("a", 0.0)]


def test_one_address_is_notified_once_of_rules_that_come_due_together() -> None:
    rules = [rule("anna", after_s=60), rule("anna", "bert"), rule("bert")]
    assert to(followed([RISE], 2000, rules)) == [("anna", 0.0), ("bert", 0.0)]


def test_nothing_is_notified_in_a_maintenance_and_those_left_after_it_are() -> None:
    quiet = [QuietSpan(UnixTime(900.0), UnixTime(2000.0), "b")]
    first = followed([RISE], 1999, quiet=quiet)
    assert to(first) == []
    second = followed([], 2000, episodes=first.open, quiet=quiet)
    assert to(second) == [("anna", 0.0)]
    assert to(followed([], 2599, episodes=second.open, quiet=quiet)) == []
    assert to(followed([], 2600, episodes=second.open, quiet=quiet)) == [("chief", 600.0)]
    elsewhere = [QuietSpan(UnixTime(900.0), UnixTime(2000.0), "other")]
    assert to(followed([RISE], 1001, quiet=elsewhere)) == [("anna", 0.0)]


def test_what_came_and_went_while_the_server_was_off_is_not_notified() -> None:
    late = 1000 + LATE_S + 1
    assert to(followed([RISE, entry(2, "clear", "unack_active", "rtn_unack")], late)) == []
    assert to(followed([RISE], late)) == [("anna", 0.0), ("chief", 600.0)]


spans = st.lists(
    st.tuples(st.integers(0, 60), st.integers(1, 30), st.sampled_from([None, "b", "other"])), max_size=4
)


@settings(max_examples=3 * settings.default.max_examples)
@given(spans, st.integers(0, 40), st.integers(0, 40))
def test_a_rule_is_due_as_a_second_model_finds_it(
    several: list[tuple[int, int, str | None]], at: int, after: int
) -> None:
    quiet = [QuietSpan(UnixTime(float(a)), UnixTime(float(a + n)), bus) for a, n, bus in several]
    episode = Episode("b.1.x", 1, 1, "b", "high", UnixTime(float(at)))

    def loud(second: int) -> bool:
        return not any(a <= second < a + n and bus in (None, "b") for a, n, bus in several)

    begins = next(second for second in range(at, 1000) if loud(second))
    expected = next(second for second in range(begins + after, 1000) if loud(second))
    assert float(due_at(episode, float(after), quiet)) == expected


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


FEW = settings(max_examples=settings.default.max_examples // 3)
"""Each example fills a week in, minute by minute."""


@FEW
@given(st.lists(periods, max_size=3), st.integers(0, 7 * DAY - 1))
def test_people_on_duty_equal_a_week_filled_in(several: list[DutyPeriod], minute: int) -> None:
    roster = DutyRoster(periods=tuple(several))
    week = filled_in(roster)
    local = MONDAY + timedelta(minutes=minute)
    assert minute_of_week(local) == minute
    assert set(roster.on_duty(local)) == (week[minute] or set(roster.addresses()))


@FEW
@given(st.lists(periods, min_size=1, max_size=3))
def test_gaps_are_the_minutes_that_have_no_one(several: list[DutyPeriod]) -> None:
    roster = DutyRoster(periods=tuple(several))
    in_gaps = {minute for first, end in roster.gaps() for minute in range(first, end)}
    assert in_gaps == {minute for minute, present in enumerate(filled_in(roster)) if not present}
    assert DutyRoster(("always",), roster.periods).gaps() == []


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
def test_a_recurring_maintenance_follows_the_clock_on_a_night_of_a_change(
    change: str, starts: str, ends: str, spans: list[tuple[str, str]]
) -> None:
    day = CHANGES[change]
    assert shown(window(starts, ends), day, day) == spans


def test_a_recurring_maintenance_ends_by_the_clock_of_the_next_day() -> None:
    spring, autumn = (CHANGES[each] - timedelta(days=1) for each in ("spring", "autumn"))
    assert shown(window("22:00", "06:00"), spring, spring) == [("27. 21:00", "28. 04:00")]
    assert shown(window("22:00", "06:00"), autumn, autumn) == [("24. 20:00", "25. 05:00")]
    assert shown(window("00:00", "00:00"), CHANGES["spring"], CHANGES["spring"]) == [
        ("27. 23:00", "28. 22:00")
    ]


def test_a_recurring_maintenance_begins_on_its_days_up_to_the_last() -> None:
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


def test_a_recurring_maintenance_is_configured_and_its_faults_are_named(tmp_path: Path) -> None:
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
async def test_nothing_is_notified_in_a_recurring_maintenance_which_page_and_api_show(
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


async def test_the_spans_of_a_recurring_maintenance_follow_the_day(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        notification = house.services[Notification]
        now = UnixTime(first_at(date(2026, 11, 23), 12 * 60, BERLIN))
        daily = window("22:00", "02:00", until=date(2026, 11, 24))
        clock = [now]
        maintenance = Maintenance(
            notification.outbox, house.services[EventLog], [daily], BERLIN, [BUS], lambda: clock[0]
        )
        covered = []
        for hour in range(0, 72, 6):
            clock[0] = UnixTime(now + 3600.0 * hour)
            covered.append(any(span.covers(BUS, clock[0]) for span in maintenance.spans()))
        assert [hour for hour, each in zip(range(0, 72, 6), covered, strict=True) if each] == [12, 36]
        assert [(each.since, each.until) for each in maintenance.recurring()] == [(None, None)]


NOW = UnixTime(10_000.0)


def at(seconds: float) -> UnixTime:
    return NOW - seconds


def turn(load: EndpointLoad, flood: int = 2) -> DeliveryTurn:
    return next_turn(load, flood, 60.0, NOW)


def test_nothing_waits_for_something_new() -> None:
    assert turn(EndpointLoad([], [], [])) == DeliveryTurn()


def test_a_new_item_is_a_message_at_once() -> None:
    assert turn(EndpointLoad([(1, at(0)), (2, at(0))], [], [at(60)])) == DeliveryTurn(items=(1,))


def test_what_stood_at_a_start_is_one_message_after_what_is_new() -> None:
    assert turn(EndpointLoad([], [], [], standing=[1, 2])) == DeliveryTurn(items=(1, 2))
    assert turn(EndpointLoad([(3, at(0))], [], [], standing=[1, 2])) == DeliveryTurn(items=(3,))


def test_a_flood_is_collected() -> None:
    sent = [at(60), at(30)]
    assert turn(EndpointLoad([(1, at(59)), (2, at(0))], [], sent)) == DeliveryTurn(wait_s=1.0)
    assert turn(EndpointLoad([(1, at(60)), (2, at(0))], [], sent)) == DeliveryTurn(items=(1, 2))
    assert turn(EndpointLoad([(1, at(0))], [], [at(601), at(602)])) == DeliveryTurn(items=(1,))


def test_a_program_gets_each_alone() -> None:
    load = EndpointLoad([(1, at(0)), (2, at(0))], [], [at(60)] * 100, collects=False)
    assert turn(load) == DeliveryTurn(items=(1,))


def test_new_items_go_before_those_that_were_refused() -> None:
    retries = [Retry(7, 3, at(0)), Retry(8, 1, at(0)), Retry(9, 1, at(-5))]
    assert turn(EndpointLoad([(1, at(60))], retries, [])) == DeliveryTurn(items=(1,))
    assert turn(EndpointLoad([(1, at(50))], retries, [])) == DeliveryTurn(retry=8)
    assert turn(EndpointLoad([], retries[2:], [])) == DeliveryTurn(wait_s=5.0)


def test_a_clock_that_was_set_back_delays_no_retry() -> None:
    assert turn(EndpointLoad([], [Retry(7, 1, at(-MAX_RETRY_S - 1))], [])) == DeliveryTurn(retry=7)
    assert turn(EndpointLoad([(1, at(-3600))], [], [at(60), at(30)])) == DeliveryTurn(items=(1,))


def test_the_wait_doubles_up_to_a_quarter_of_an_hour() -> None:
    assert [retry_after_s(n) for n in (1, 2, 3)] == [5.0, 10.0, 20.0]
    assert retry_after_s(10_000) == MAX_RETRY_S


def test_a_message_is_given_up_after_a_day() -> None:
    assert state_after_failure(at(GIVE_UP_S - 1), NOW) == "retrying"
    assert state_after_failure(at(GIVE_UP_S), NOW) == "failed"


retries = st.lists(
    st.builds(Retry, st.integers(1, 9), st.integers(1, 5), st.floats(-2e3, 2e3).map(at)), max_size=4
)


@given(st.integers(0, 3), retries, st.integers(0, 4), st.booleans())
def test_there_is_always_a_turn_or_an_end_of_the_wait(
    items: int, several: list[Retry], sent: int, collects: bool
) -> None:
    load = EndpointLoad([(n, at(0)) for n in range(items)], several, [at(1)] * sent, collects)
    found = turn(load)
    is_idle = not items and not several
    assert is_idle == (found == DeliveryTurn())
    if found.wait_s is not None:
        assert 0 < found.wait_s <= MAX_RETRY_S


@pytest.mark.parametrize(
    ("before", "now", "day"),
    [
        ("2026-11-22T06:59:50", "2026-11-22T07:00:10", "2026-11-22"),
        ("2026-11-22T07:00:10", "2026-11-22T07:00:30", ""),
        ("2026-11-22T06:00:00", "2026-11-22T06:59:59", ""),
        ("2026-11-21T23:59:50", "2026-11-22T07:00:00", "2026-11-22"),
        ("2026-11-22T07:00:10", "2026-11-22T06:30:00", ""),
    ],
)
def test_a_heartbeat_is_due_when_its_time_has_come(before: str, now: str, day: str) -> None:
    assert heartbeat_due(datetime.fromisoformat(before), datetime.fromisoformat(now), 420) == day


def test_the_plan_notifies_who_is_on_duty_and_every_program() -> None:
    """A group of two on weekdays from 06:00 to 02:00, a webhook at any time, and a reader of reports."""
    hours = {"days": DAYS[:5], "starts": "06:00", "ends": "22:00", "to": ["day@plant"]}
    night = {"days": DAYS[:5], "starts": "22:00", "ends": "02:00", "to": ["night@plant"]}
    hook = {"url": "https://plant.example/x", "secret_file": "hook.key"}
    plan = NotificationPlan(
        NotifySettings.model_validate(
            {
                "smtp": {"host": "mail", "sender": "lineside@plant", "to": ["boss@plant"]},
                "group": [{"name": "duty", "duty": [hours, night]}],
                "rule": [{"group": "duty"}],
                "webhook": [hook],
            }
        ),
        readers=["reader@plant"],
    )
    monday = datetime(2026, 11, 30, 12)
    (webhook,) = (key for key in plan.endpoints if key.startswith("webhook:plant.example#"))
    mail = {f"mail:{name}@plant" for name in ("boss", "day", "night", "reader")}
    assert set(plan.endpoints) == {webhook} | mail
    assert plan.on_duty("duty", monday) == ["day@plant"]
    assert plan.on_duty("duty", monday.replace(hour=23)) == ["night@plant"]
    assert plan.present(monday) == ("mail:boss@plant", webhook, "mail:day@plant")
    spans = [(gap.params["first"], gap.params["last"]) for gap in plan.gaps("duty")]
    assert ("02:00", "06:00") in spans
