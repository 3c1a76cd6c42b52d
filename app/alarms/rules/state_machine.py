"""What happens to an alarm: its condition is observed, time passes, a person acts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from app.alarms.rules.facts import (
    AlarmAttributes,
    AlarmFacts,
    Transition,
    detection_due,
    due_at,
    realarm_due,
)
from app.alarms.rules.states import ON_RETURN, TRANSITIONS, AlarmTrigger, BaseState, BaseTrigger
from bus.instants import UnixTime

Changed = tuple[AlarmFacts, tuple[Transition, ...]]
StateChange = Callable[[AlarmFacts, AlarmAttributes, UnixTime], Changed]
Unhiding = Literal["unshelve", "unsuppress", "return"]

_ENDED: dict[Unhiding, Callable[[AlarmFacts], AlarmFacts]] = {
    "unshelve": lambda facts: replace(facts, shelved_until=None, shelved_once=False),
    "unsuppress": lambda facts: replace(facts, suppressed=False),
    "return": lambda facts: replace(facts, out_of_service=False),
}
_STAMPED: dict[BaseTrigger, Callable[[AlarmFacts, UnixTime], AlarmFacts]] = {
    "rise": lambda facts, at: replace(
        facts, occurrence=facts.occurrence + 1, came=at, cleared=None, acknowledged_at=None
    ),
    "clear": lambda facts, at: replace(facts, cleared=at),
    "acknowledge": lambda facts, at: replace(facts, acknowledged_at=at),
}
"""The time of each of the three moments of an occurrence: it came, cleared, was acknowledged."""


class NoTransitionError(Exception):
    """The standard has no such transition from the present state."""


def observe(facts: AlarmFacts, attributes: AlarmAttributes, holds: bool | None, at: UnixTime) -> Changed:
    """Its condition holds, does not, or is not known (None): then it neither rises nor clears."""
    facts, passed = advance(facts, attributes, at)
    if holds is None:
        unknown_since = at if facts.unknown_since is None else facts.unknown_since
        return replace(facts, unknown_since=unknown_since, changing_since=None), passed
    if holds == facts.active:
        changing_since = None
    else:
        changing_since = at if facts.changing_since is None else facts.changing_since
    facts = replace(facts, unknown_since=None, changing_since=changing_since)
    facts, due = advance(facts, attributes, at)
    return facts, passed + due


def advance(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    """Everything that time alone brings up to ``at``, each at its own time."""
    done: tuple[Transition, ...] = ()
    while (due := due_at(facts, attributes)) is not None and due <= at:
        facts, transitions = _come_due(facts, attributes, due)
        done += transitions
    return facts, done


def _come_due(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    if detection_due(facts, attributes) == at:
        return _detect(facts, attributes, at)
    if realarm_due(facts, attributes) == at:
        return _base(facts, attributes, "realarm", at)
    return _unhide(facts, "unshelve", at)


def _detect(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    cleared = facts.active
    facts = replace(facts, changing_since=None)
    facts, done = _base(facts, attributes, "clear" if cleared else "rise", at)
    if cleared and facts.shelved_once:
        facts, ended = _unhide(facts, "unshelve", at)
        done += ended
    return facts, done


def acknowledge(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    """A person has seen it. Raises NoTransitionError, also while it is hidden."""
    if facts.is_hidden:
        raise NoTransitionError
    return _base(facts, attributes, "acknowledge", at)


def reset(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    """End a latch. Raises NoTransitionError, also while it is hidden."""
    if facts.is_hidden:
        raise NoTransitionError
    return _base(facts, attributes, "reset", at)


def silence(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """End its sound, which leaves its state. Raises NoTransitionError where it does not sound."""
    if not facts.sounds:
        raise NoTransitionError
    return _moved(facts, replace(facts, silenced=True), "silence", at)


def shelve(
    facts: AlarmFacts, _: AlarmAttributes, at: UnixTime, *, for_s: float, once: bool = False
) -> Changed:
    """Hide it for a time; ``once``: or until its condition ends. Raises NoTransitionError."""
    if facts.shelved_until is not None or facts.out_of_service:
        raise NoTransitionError
    return _moved(facts, replace(facts, shelved_until=at + for_s, shelved_once=once), "shelve", at)


def unshelve(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """End the shelving before its time. Raises NoTransitionError."""
    if facts.shelved_until is None:
        raise NoTransitionError
    return _unhide(facts, "unshelve", at)


def remove_from_service(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """Hide it until it is returned to service. Raises NoTransitionError."""
    if facts.out_of_service:
        raise NoTransitionError
    return _moved(facts, replace(facts, out_of_service=True), "remove", at)


def return_to_service(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """Annunciate it again. Raises NoTransitionError."""
    if not facts.out_of_service:
        raise NoTransitionError
    return _unhide(facts, "return", at)


def withdraw(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    """Its definition ends, and with it the alarm: it goes out of service, ends there, and is normal on its
    return. An active alarm clears; nothing is annunciated on the way. No transition where it is normal."""
    facts = replace(facts, changing_since=None, unknown_since=None)
    if facts.state == "normal":
        return facts, ()
    done: tuple[Transition, ...] = ()
    while (step := _next_withdrawal(facts)) is not None:
        facts, transitions = step(facts, attributes, at)
        done += transitions
    return facts, done


def _next_withdrawal(facts: AlarmFacts) -> StateChange | None:
    if facts.state == "normal":
        return None
    if not facts.out_of_service:
        return remove_from_service
    if facts.active:
        return lambda facts, attributes, at: _base(facts, attributes, "clear", at)
    if facts.latched:
        trigger: BaseTrigger = "reset" if facts.acknowledged else "acknowledge"
        return lambda facts, attributes, at: _base(facts, attributes, trigger, at)
    if facts.shelved_until is not None:
        return unshelve
    if facts.suppressed:
        return lambda facts, _, at: suppress(facts, False, at)
    return return_to_service


def suppress(facts: AlarmFacts, suppressed: bool, at: UnixTime) -> Changed:
    """Suppression by design begins or ends; nothing where that is so already."""
    if facts.suppressed == suppressed:
        return facts, ()
    if suppressed:
        return _moved(facts, replace(facts, suppressed=True), "suppress", at)
    return _unhide(facts, "unsuppress", at)


def _base(facts: AlarmFacts, attributes: AlarmAttributes, trigger: BaseTrigger, at: UnixTime) -> Changed:
    target = TRANSITIONS.get((facts.base, trigger))
    if target is None:
        raise NoTransitionError
    base = target.latching if attributes.latching else target.plain
    after = _in_base(facts, base)
    if trigger in _STAMPED:
        after = _STAMPED[trigger](after, at)
    return _moved(facts, after, trigger, at)


def _unhide(facts: AlarmFacts, trigger: Unhiding, at: UnixTime) -> Changed:
    after = _ENDED[trigger](facts)
    if not after.is_hidden:
        after = _in_base(after, ON_RETURN[after.base])
    return _moved(facts, after, trigger, at)


def _in_base(facts: AlarmFacts, base: BaseState) -> AlarmFacts:
    after = facts.with_base(base)
    return after if after.acknowledged else replace(after, acknowledged_at=None)


def _moved(before: AlarmFacts, after: AlarmFacts, trigger: AlarmTrigger, at: UnixTime) -> Changed:
    if after.state != before.state:
        after = replace(after, since=at, silenced=after.silenced and trigger == "clear")
    return after, (Transition(at, trigger, after.occurrence, before.state, after.state),)
