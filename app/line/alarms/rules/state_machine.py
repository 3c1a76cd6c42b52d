"""The state machine of an alarm (ISA-18.2-2016, clause 5.6): its states, and what leads from one to another.

Pure: the time is passed in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

from bus.instants import UnixTime

BaseState = Literal["normal", "unack_active", "ack_active", "rtn_unack", "latched_unack", "latched_ack"]
AlarmState = Literal[BaseState, "shelved", "suppressed", "out_of_service"]
PRESENT_STATES: tuple[AlarmState, ...] = get_args(AlarmState)[1:]
"""Every state but normal."""
BaseTrigger = Literal["rise", "clear", "acknowledge", "reset", "realarm"]
AlarmTrigger = Literal[
    BaseTrigger, "shelve", "unshelve", "suppress", "unsuppress", "remove", "return", "silence"
]


class BaseFacts(NamedTuple):
    """The three facts that make a base state (OPC UA Part 9: ActiveState, AckedState, LatchedState)."""

    active: bool
    acknowledged: bool
    latched: bool = False


FACTS_OF: dict[BaseState, BaseFacts] = {
    "normal": BaseFacts(active=False, acknowledged=True),
    "unack_active": BaseFacts(active=True, acknowledged=False),
    "ack_active": BaseFacts(active=True, acknowledged=True),
    "rtn_unack": BaseFacts(active=False, acknowledged=False),
    "latched_unack": BaseFacts(active=False, acknowledged=False, latched=True),
    "latched_ack": BaseFacts(active=False, acknowledged=True, latched=True),
}
STATE_OF: dict[BaseFacts, BaseState] = {facts: state for state, facts in FACTS_OF.items()}


class Target(NamedTuple):
    """Where a trigger leads: an alarm that does not latch, and one that does."""

    plain: BaseState
    latching: BaseState


def _both(state: BaseState) -> Target:
    return Target(state, state)


TRANSITIONS: dict[tuple[BaseState, BaseTrigger], Target] = {
    ("normal", "rise"): _both("unack_active"),
    ("unack_active", "acknowledge"): _both("ack_active"),
    ("unack_active", "clear"): Target("rtn_unack", "latched_unack"),
    ("ack_active", "clear"): Target("normal", "latched_ack"),
    ("ack_active", "realarm"): _both("unack_active"),
    ("rtn_unack", "acknowledge"): _both("normal"),
    ("rtn_unack", "rise"): _both("unack_active"),
    ("latched_unack", "acknowledge"): _both("latched_ack"),
    ("latched_unack", "rise"): _both("unack_active"),
    ("latched_ack", "reset"): _both("normal"),
    ("latched_ack", "rise"): _both("unack_active"),
}
"""Every transition between base states; what is not here does not happen."""

ON_RETURN: dict[BaseState, BaseState] = {
    "normal": "normal",
    "unack_active": "unack_active",
    "ack_active": "unack_active",
    "rtn_unack": "normal",
    "latched_unack": "latched_unack",
    "latched_ack": "latched_unack",
}
"""Out of a hidden state (shelved, suppressed, out of service) an alarm comes back as normal or, where its
condition holds, unacknowledged: G, H, I → A or B. Only a reset ends a latch."""


@dataclass(frozen=True, slots=True)
class AlarmAttributes:
    """The attributes of an alarm (ISA-18.2-2016, clause 10). Durations in seconds."""

    on_delay_s: float = 0.0
    off_delay_s: float = 0.0
    realarm_s: float | None = None
    """After which an acknowledged alarm that still holds is unacknowledged again; None: never."""
    latching: bool = False
    """It stays after its condition has ended, until a person resets it."""


@dataclass(frozen=True, slots=True)
class AlarmFacts:
    """``occurrence`` counts how often it has risen; an acknowledgement names one of them."""

    active: bool = False
    acknowledged: bool = True
    latched: bool = False
    silenced: bool = False
    """Its sound was ended; it sounds again when it comes again."""
    suppressed: bool = False
    out_of_service: bool = False
    shelved_until: UnixTime | None = None
    shelved_once: bool = False
    """Shelved until its condition ends, at most until ``shelved_until``."""
    occurrence: int = 0
    since: UnixTime | None = None
    """When it got into its state."""
    came: UnixTime | None = None
    """When its occurrence began; no act of a person changes it."""
    cleared: UnixTime | None = None
    """When the condition of its occurrence ended; None: it holds."""
    acknowledged_at: UnixTime | None = None
    """When a person acknowledged its occurrence; None: none has."""
    changing_since: UnixTime | None = None
    """Since when its condition is other than ``active``: a delay runs."""
    unknown_since: UnixTime | None = None
    """Since when nothing is known of its condition."""

    @property
    def base(self) -> BaseState:
        """The state that it would have if nothing hid it."""
        return STATE_OF[BaseFacts(self.active, self.acknowledged, self.latched)]

    @property
    def is_hidden(self) -> bool:
        """Whether it is detected and recorded, and not annunciated."""
        return self.suppressed or self.is_hidden_by_person

    @property
    def is_hidden_by_person(self) -> bool:
        """Whether a person hid it, and has to end that or wait."""
        return self.out_of_service or self.shelved_until is not None

    @property
    def sounds(self) -> bool:
        """Whether it is audible (ISA-18.2-2016, 5.6): what has returned waits without a sound."""
        return not (self.is_hidden or self.acknowledged or self.silenced) and (self.active or self.latched)

    @property
    def state(self) -> AlarmState:
        """Its state. Of several that hide it, the one that a person has to end is named."""
        if self.out_of_service:
            return "out_of_service"
        if self.shelved_until is not None:
            return "shelved"
        return "suppressed" if self.suppressed else self.base

    def with_base(self, base: BaseState) -> AlarmFacts:
        """Return these facts in another base state."""
        facts = FACTS_OF[base]
        return replace(self, active=facts.active, acknowledged=facts.acknowledged, latched=facts.latched)


_TIMES = ("shelved_until", "since", "came", "cleared", "acknowledged_at", "changing_since", "unknown_since")


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of an alarm. ``before`` equals ``after`` where only something hidden has changed."""

    at: UnixTime
    trigger: AlarmTrigger
    occurrence: int
    before: AlarmState
    after: AlarmState


def due_at(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    """Return when the next transition comes by time alone; None: never."""
    times = (detection_due(facts, attributes), facts.shelved_until, realarm_due(facts, attributes))
    return min((time for time in times if time is not None), default=None)


def detection_due(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    """Return when a running delay ends; None where none runs."""
    if facts.changing_since is None:
        return None
    return facts.changing_since + (attributes.off_delay_s if facts.active else attributes.on_delay_s)


def realarm_due(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    """Return when an acknowledged alarm is annunciated again; None: never."""
    if attributes.realarm_s is None or facts.acknowledged_at is None or facts.is_hidden or not facts.active:
        return None
    return facts.acknowledged_at + attributes.realarm_s


def shifted(facts: AlarmFacts, step_s: float) -> AlarmFacts:
    """The facts of an alarm after the clock was set by ``step_s``: every time keeps its distance from now."""
    times = {name: getattr(facts, name) for name in _TIMES}
    moved: dict[str, Any] = {name: time + step_s for name, time in times.items() if time is not None}
    return replace(facts, **moved)


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
    """Observe the condition of an alarm. While it is not known (None), the alarm neither rises nor clears."""
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
    """Apply every transition that is due by time alone up to ``at``, each at its own time."""
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
    """Acknowledge an alarm. Raises NoTransitionError, also while it is hidden."""
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
