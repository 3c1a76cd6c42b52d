"""Alarms by rule: random histories against the model of the standard, single transitions, and detection."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from itertools import product
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.line.alarms import rules
from app.line.alarms.rules import (
    AlarmAttributes,
    AlarmFacts,
    Changed,
    ChangeRate,
    CountWindow,
    FirstOut,
    LimitRule,
    NoTransitionError,
    Suppressors,
    due_at,
    is_at_rest,
    limits_of,
    shifted,
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
from tests.app.alarm_model import FOREVER, ModelAlarm

CHANGES: dict[str, Callable[[AlarmFacts, AlarmAttributes, UnixTime], Changed]] = {
    "acknowledge": rules.acknowledge,
    "silence": rules.silence,
    "reset": rules.reset,
    "unshelve": rules.unshelve,
    "remove": rules.remove_from_service,
    "return": rules.return_to_service,
    "suppress": lambda facts, _how, at: rules.suppress(facts, True, at),
    "unsuppress": lambda facts, _how, at: rules.suppress(facts, False, at),
}
ACTS = ("shelve", *CHANGES)
STEPS = st.one_of(
    st.tuples(st.just("observe"), st.sampled_from((True, False, True, False, None))),
    st.tuples(st.sampled_from(ACTS), st.tuples(st.integers(1, 8), st.booleans())),
)
HISTORIES = st.lists(st.tuples(st.integers(1, 4), STEPS), max_size=40)


def act(facts: AlarmFacts, how: AlarmAttributes, word: str, at: float, end: float, once: bool) -> Changed:
    """One act of a person or of the suppression."""
    if word == "shelve":
        return rules.shelve(facts, how, UnixTime(at), for_s=end - at, once=once)
    return CHANGES[word](facts, how, UnixTime(at))


@settings(max_examples=3 * settings.default.max_examples)
@given(
    st.sampled_from((0.0, 2.5)),
    st.sampled_from((0.0, 1.5)),
    st.sampled_from((None, 3.125)),
    st.booleans(),
    HISTORIES,
)
def test_random_histories_equal_the_model_of_the_standard(
    on_delay: float,
    off_delay: float,
    realarm: float | None,
    latching: bool,
    history: list[tuple[int, tuple[str, object]]],
) -> None:
    how = AlarmAttributes(on_delay, off_delay, realarm, latching=latching)
    model = ModelAlarm(on_delay, off_delay, realarm or FOREVER, latching)
    facts, journal, at = AlarmFacts(), list[str](), 0.0
    for wait_s, (word, details) in history:
        for _ in range(wait_s):
            at += 1
            facts, passed = rules.advance(facts, how, UnixTime(at))
            journal += [each.trigger for each in passed]
            assert (facts.state, facts.occurrence) == (model.state(at), model.occurrences(at))
        if word == "observe":
            assert details in (True, False, None)
            model.observed.append((at, details))  # type: ignore[arg-type]
            facts, done = rules.observe(facts, how, details, UnixTime(at))  # type: ignore[arg-type]
        else:
            assert isinstance(details, tuple)
            end, once = (at + details[0] + 0.25, details[1]) if word == "shelve" else (FOREVER, False)
            allowed = model.allows(word, at)
            try:
                facts, done = act(facts, how, word, at, end, once)
            except NoTransitionError:
                done = ()
            assert bool(done) == allowed
            if allowed:
                model.acts.append((at, word, end, once))
        journal += [each.trigger for each in done]
        assert (facts.state, facts.occurrence) == (model.state(at), model.occurrences(at))
    found = model.detections(at)
    assert [word for word in journal if word in ("rise", "clear")] == [
        "rise" if rises else "clear" for _, rises in found
    ]


@given(st.sampled_from((0.0, 2.5)), st.booleans(), HISTORIES)
def test_an_alarm_whose_definition_ends_is_normal_as_the_standard_leads_there(
    on_delay: float, latching: bool, history: list[tuple[int, tuple[str, object]]]
) -> None:
    how = AlarmAttributes(on_delay, latching=latching)
    model, facts, at = ModelAlarm(on_delay, 0, FOREVER, latching), AlarmFacts(), 0.0
    for wait_s, (word, details) in history:
        at += wait_s
        facts, _ = rules.advance(facts, how, UnixTime(at))
        if word == "observe":
            model.observed.append((at, details))  # type: ignore[arg-type]
            facts, _ = rules.observe(facts, how, details, UnixTime(at))  # type: ignore[arg-type]
        elif model.allows(word, at):
            facts, _ = act(facts, how, word, at, FOREVER, once=False)
            model.acts.append((at, word, FOREVER, False))
    before = facts
    facts, done = rules.withdraw(facts, how, UnixTime(at))
    for each in done:
        if each.trigger == "clear":
            model.observed.append((at, False))
        else:
            model.acts.append((at, each.trigger, FOREVER, False))
    assert (facts.state, model.state(at), facts.occurrence) == ("normal", "normal", model.occurrences(at))
    assert due_at(facts, how) is None
    assert bool(done) == (before.state != "normal")
    assert not any(each.after in ("unack_active", "latched_unack") for each in done)
    assert [each.before for each in done[1:]] == [each.after for each in done[:-1]]


def test_a_suppressed_alarm_whose_definition_ends_is_normal_and_no_longer_suppressed() -> None:
    how = AlarmAttributes()
    facts, _ = rules.observe(AlarmFacts(), how, holds=True, at=UnixTime(10))
    facts, _ = rules.suppress(facts, True, UnixTime(11))
    facts, done = rules.withdraw(facts, how, UnixTime(12))
    assert [each.trigger for each in done] == ["remove", "clear", "unsuppress", "return"]
    assert (facts.state, facts.suppressed) == ("normal", False)


@pytest.mark.parametrize(
    ("active", "acknowledged", "latched", "base", "acknowledge", "reset"),
    [
        (False, True, False, "normal", None, None),
        (True, False, False, "unack_active", "ack_active", None),
        (True, True, False, "ack_active", None, None),
        (False, False, False, "rtn_unack", "normal", None),
        (False, False, True, "latched_unack", "latched_ack", None),
        (False, True, True, "latched_ack", None, "normal"),
    ],
)
def test_people_lead_a_base_state_only_where_the_standard_does(
    active: bool, acknowledged: bool, latched: bool, base: str, acknowledge: str | None, reset: str | None
) -> None:
    facts = AlarmFacts(active=active, acknowledged=acknowledged, latched=latched)
    assert facts.base == base
    for change, target in ((rules.acknowledge, acknowledge), (rules.reset, reset)):
        if target is None:
            with pytest.raises(NoTransitionError):
                change(facts, AlarmAttributes(), UnixTime(1))
        else:
            assert change(facts, AlarmAttributes(), UnixTime(1))[0].base == target


def test_a_shelf_for_once_ends_with_the_condition_and_hides_from_acts_until_then() -> None:
    how = AlarmAttributes()
    facts, _ = rules.observe(AlarmFacts(), how, holds=True, at=UnixTime(10))
    facts, _ = rules.shelve(facts, how, UnixTime(11), for_s=88, once=True)
    for hidden_act in (rules.acknowledge, rules.reset):
        with pytest.raises(NoTransitionError):
            hidden_act(facts, how, UnixTime(12))
    with pytest.raises(NoTransitionError):
        rules.shelve(facts, how, UnixTime(12), for_s=87)
    facts, done = rules.observe(facts, how, holds=False, at=UnixTime(13))
    assert ([each.trigger for each in done], facts.shelved_until) == (["clear", "unshelve"], None)


def test_a_shelving_is_ended_before_its_time_and_only_once() -> None:
    how = AlarmAttributes()
    facts, _ = rules.shelve(AlarmFacts(), how, UnixTime(1), for_s=60)
    facts, done = rules.unshelve(facts, how, UnixTime(2))
    assert ([each.trigger for each in done], facts.shelved_until) == (["unshelve"], None)
    with pytest.raises(NoTransitionError):
        rules.unshelve(facts, how, UnixTime(3))


def test_an_unknown_condition_stops_a_delay_and_changes_nothing_else() -> None:
    how = AlarmAttributes(on_delay_s=2)
    facts, _ = rules.observe(AlarmFacts(), how, holds=True, at=UnixTime(1))
    facts, _ = rules.observe(facts, how, holds=None, at=UnixTime(2))
    facts, _ = rules.observe(facts, how, holds=None, at=UnixTime(9))
    assert (facts.state, facts.unknown_since) == ("normal", 2)
    facts, _ = rules.observe(facts, how, holds=True, at=UnixTime(10))
    facts, done = rules.advance(facts, how, UnixTime(12))
    assert (facts.state, facts.unknown_since, done[0].at) == ("unack_active", None, 12)


def test_a_transition_has_the_time_at_which_it_was_due() -> None:
    how = AlarmAttributes(on_delay_s=5, off_delay_s=2)
    facts, _ = rules.observe(AlarmFacts(), how, holds=True, at=UnixTime(10))
    assert due_at(facts, how) == 15
    facts, done = rules.observe(facts, how, holds=False, at=UnixTime(40))
    assert [(each.trigger, each.at) for each in done] == [("rise", 15)]
    assert due_at(facts, how) == 42


def test_running_times_keep_their_length_when_the_clock_is_set() -> None:
    facts = AlarmFacts(shelved_until=UnixTime(100), changing_since=UnixTime(90))
    later = shifted(facts, -50.0)
    assert (later.shelved_until, later.changing_since, later.unknown_since) == (50, 40, None)


def times(facts: AlarmFacts) -> tuple[float | None, float | None, float | None]:
    """When it came, cleared and was acknowledged."""
    return facts.came, facts.cleared, facts.acknowledged_at


def test_coming_clearing_and_acknowledging_are_three_times_and_none_changes_another() -> None:
    how = AlarmAttributes()
    facts, _ = rules.observe(AlarmFacts(), how, holds=True, at=UnixTime(10))
    assert times(facts) == (10, None, None)
    facts, _ = rules.acknowledge(facts, how, UnixTime(12))
    assert (times(facts), facts.since) == ((10, None, 12), 12)
    facts, _ = rules.observe(facts, how, holds=False, at=UnixTime(15))
    assert (times(facts), facts.since) == ((10, 15, 12), 15)
    facts, _ = rules.observe(facts, how, holds=True, at=UnixTime(20))
    assert times(facts) == (20, None, None)
    facts, _ = rules.observe(facts, how, holds=False, at=UnixTime(25))
    facts, _ = rules.acknowledge(facts, how, UnixTime(30))
    assert (times(facts), facts.state) == ((20, 25, 30), "normal")


def test_an_acknowledgement_ends_where_it_is_annunciated_again_and_the_time_it_came_stays() -> None:
    how = AlarmAttributes(realarm_s=3)
    facts, _ = rules.observe(AlarmFacts(), how, holds=True, at=UnixTime(10))
    facts, _ = rules.acknowledge(facts, how, UnixTime(12))
    again, _ = rules.advance(facts, how, UnixTime(15))
    assert times(again) == (10, None, None)
    hidden, _ = rules.shelve(facts, how, UnixTime(13), for_s=1)
    back, _ = rules.advance(hidden, how, UnixTime(14))
    assert (times(back), back.state) == ((10, None, None), "unack_active")


def test_the_three_times_move_with_the_clock() -> None:
    facts = AlarmFacts(came=UnixTime(10), cleared=UnixTime(20), acknowledged_at=UnixTime(30))
    assert times(shifted(facts, 100.0)) == (110, 120, 130)


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


def test_the_first_alarm_of_a_disturbance_is_named_with_how_many_it_has() -> None:
    first_out = FirstOut()
    rises = (("a", 0), ("b", 5), ("a", 5), ("c", 5.1), ("d", 6), ("e", 2))
    firsts = [first_out.rise(alarm, UnixTime(at)) for alarm, at in rises]
    assert firsts == [("a", 1), ("a", 2), ("a", 2), ("c", 1), ("c", 2), ("e", 1)]


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
