"""One alarm as independent facts; its state follows from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from app.alarms.rules.states import FACTS_OF, STATE_OF, AlarmState, AlarmTrigger, BaseFacts, BaseState
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class AlarmAttributes:
    """How an alarm behaves (ISA-18.2-2016, clause 10). Durations in seconds."""

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
        """These facts in another base state."""
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
    """When the next transition comes by time alone; None: never."""
    times = (detection_due(facts, attributes), facts.shelved_until, realarm_due(facts, attributes))
    return min((time for time in times if time is not None), default=None)


def detection_due(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    """When a running delay ends."""
    if facts.changing_since is None:
        return None
    return facts.changing_since + (attributes.off_delay_s if facts.active else attributes.on_delay_s)


def realarm_due(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    """When an acknowledged alarm is annunciated again."""
    if attributes.realarm_s is None or facts.acknowledged_at is None or facts.is_hidden or not facts.active:
        return None
    return facts.acknowledged_at + attributes.realarm_s


def shifted(facts: AlarmFacts, step_s: float) -> AlarmFacts:
    """The facts of an alarm after the clock was set by ``step_s``: every time keeps its distance from now."""
    times = {name: getattr(facts, name) for name in _TIMES}
    moved: dict[str, Any] = {name: time + step_s for name, time in times.items() if time is not None}
    return replace(facts, **moved)
