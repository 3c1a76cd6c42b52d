"""Which address is notified of what and when, against a second model that looks at each second."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from hypothesis import given, settings
from hypothesis import strategies as st

from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules.state_machine import AlarmState, AlarmTrigger
from app.records.notification.rules.notices import (
    LATE_S,
    Episode,
    NotificationRule,
    QuietSpan,
    due_at,
    follow,
)
from app.records.notification.rules.roster import DutyRoster
from bus.instants import UnixTime

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
