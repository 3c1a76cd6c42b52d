"""The rules of an alarm: its state machine (ISA-18.2-2016, clause 5.6), and its detection. Pure: the time is
passed in.

The base state follows from three facts: active, acknowledged and latched (OPC UA Part 9). An alarm that is
shelved, suppressed or out of service is hidden: it is detected and recorded, and not annunciated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import lru_cache
from typing import Any, Literal, get_args

from app.line.conditions.condition import CountPredicate, SuppressionGroup, Tuning
from bus.instants import UnixTime

BaseState = Literal["normal", "unack_active", "ack_active", "rtn_unack", "latched_unack", "latched_ack"]
AlarmState = Literal[BaseState, "shelved", "suppressed", "out_of_service"]
PRESENT_STATES: tuple[AlarmState, ...] = get_args(AlarmState)[1:]
"""The states except normal."""
AlarmTrigger = Literal[
    "rise",
    "clear",
    "acknowledge",
    "reset",
    "realarm",
    "shelve",
    "unshelve",
    "suppress",
    "unsuppress",
    "remove",
    "return",
    "silence",
]


@dataclass(frozen=True, slots=True)
class AlarmAttributes:
    """The attributes of an alarm (ISA-18.2-2016, clause 10). Durations in seconds."""

    on_delay_s: float = 0.0
    off_delay_s: float = 0.0
    realarm_s: float | None = None
    """The seconds after its acknowledgement when an active alarm is annunciated again; None: never."""
    latching: bool = False
    """Whether the alarm stays after its condition has ended, until a person resets it."""


@dataclass(frozen=True, slots=True)
class AlarmFacts:
    """The facts about an alarm. ``occurrence`` counts how often it has risen."""

    active: bool = False
    acknowledged: bool = True
    latched: bool = False
    silenced: bool = False
    """Whether a person ended the sound; the alarm sounds again when it comes again."""
    suppressed: bool = False
    out_of_service: bool = False
    shelved_until: UnixTime | None = None
    shelved_once: bool = False
    """Whether the shelving ends with the condition, at the latest at ``shelved_until``."""
    occurrence: int = 0
    since: UnixTime | None = None
    """The time when the present state began."""
    came: UnixTime | None = None
    """The time when the occurrence began; no act of a person changes it."""
    cleared: UnixTime | None = None
    """The time when the condition of the occurrence ended; None: it holds."""
    acknowledged_at: UnixTime | None = None
    """The time when a person acknowledged the occurrence; None: no one has."""
    changing_since: UnixTime | None = None
    """The time when the condition became other than ``active``, which starts a delay."""
    unknown_since: UnixTime | None = None
    """The time since which the condition is not known."""

    @property
    def base(self) -> BaseState:
        """The state that the alarm would have if nothing hid it."""
        if self.active:
            return "ack_active" if self.acknowledged else "unack_active"
        if self.latched:
            return "latched_ack" if self.acknowledged else "latched_unack"
        return "normal" if self.acknowledged else "rtn_unack"

    @property
    def is_hidden(self) -> bool:
        """Whether the alarm is detected and recorded, and not annunciated."""
        return self.suppressed or self.is_hidden_by_person

    @property
    def is_hidden_by_person(self) -> bool:
        """Whether a person hid the alarm, and has to end that or wait."""
        return self.out_of_service or self.shelved_until is not None

    @property
    def sounds(self) -> bool:
        """Whether the alarm is audible (ISA-18.2-2016, 5.6). One that has cleared waits without a sound."""
        return not (self.is_hidden or self.acknowledged or self.silenced) and (self.active or self.latched)

    @property
    def state(self) -> AlarmState:
        """The present state. If several things hide the alarm, the one that a person has to end counts."""
        if self.out_of_service:
            return "out_of_service"
        if self.shelved_until is not None:
            return "shelved"
        return "suppressed" if self.suppressed else self.base


_TIMES = ("shelved_until", "since", "came", "cleared", "acknowledged_at", "changing_since", "unknown_since")


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of an alarm. ``before`` equals ``after`` if only something hidden has changed."""

    at: UnixTime
    trigger: AlarmTrigger
    occurrence: int
    before: AlarmState
    after: AlarmState


Changed = tuple[AlarmFacts, tuple[Transition, ...]]
"""The facts after a change, and the transitions that led there."""


class NoTransitionError(Exception):
    """Raised when the standard has no such transition from the present state."""


def due_at(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    """Return when the next transition is due by time alone; None: never."""
    times = (_detection_due(facts, attributes), facts.shelved_until, _realarm_due(facts, attributes))
    return min((time for time in times if time is not None), default=None)


def _detection_due(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    if facts.changing_since is None:
        return None
    return facts.changing_since + (attributes.off_delay_s if facts.active else attributes.on_delay_s)


def _realarm_due(facts: AlarmFacts, attributes: AlarmAttributes) -> UnixTime | None:
    if attributes.realarm_s is None or facts.acknowledged_at is None or facts.is_hidden or not facts.active:
        return None
    return facts.acknowledged_at + attributes.realarm_s


def shifted(facts: AlarmFacts, step_s: float) -> AlarmFacts:
    """Return the facts after the clock was set by ``step_s``: every time keeps its distance from now."""
    times = {name: getattr(facts, name) for name in _TIMES}
    moved: dict[str, Any] = {name: time + step_s for name, time in times.items() if time is not None}
    return replace(facts, **moved)


def observe(facts: AlarmFacts, attributes: AlarmAttributes, holds: bool | None, at: UnixTime) -> Changed:
    """Apply whether the condition holds. While that is not known (None), the alarm neither rises nor
    clears."""
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
    if _detection_due(facts, attributes) == at:
        return _detect(facts, attributes, at)
    if _realarm_due(facts, attributes) == at:
        return _moved(facts, replace(facts, acknowledged=False, acknowledged_at=None), "realarm", at)
    return _unshelved(facts, at)


def _detect(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    facts = replace(facts, changing_since=None)
    if not facts.active:
        return _risen(facts, at)
    facts, done = _cleared(facts, attributes, at)
    if facts.shelved_once:
        facts, ended = _unshelved(facts, at)
        done += ended
    return facts, done


def acknowledge(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """Acknowledge an alarm. Raise NoTransitionError, even while the alarm is hidden."""
    if facts.is_hidden or facts.acknowledged:
        raise NoTransitionError
    return _acknowledged(facts, at)


def reset(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """End a latch. Raise NoTransitionError, even while the alarm is hidden."""
    if facts.is_hidden or not (facts.latched and facts.acknowledged):
        raise NoTransitionError
    return _reset(facts, at)


def silence(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """End the sound of an alarm, whose state stays. Raise NoTransitionError if it does not sound."""
    if not facts.sounds:
        raise NoTransitionError
    return _moved(facts, replace(facts, silenced=True), "silence", at)


def shelve(
    facts: AlarmFacts, _: AlarmAttributes, at: UnixTime, *, for_s: float, once: bool = False
) -> Changed:
    """Hide an alarm for a time; ``once``: or until its condition ends. Raise NoTransitionError."""
    if facts.shelved_until is not None or facts.out_of_service:
        raise NoTransitionError
    return _moved(facts, replace(facts, shelved_until=at + for_s, shelved_once=once), "shelve", at)


def unshelve(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """End a shelving before its time. Raise NoTransitionError."""
    if facts.shelved_until is None:
        raise NoTransitionError
    return _unshelved(facts, at)


def remove_from_service(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """Hide an alarm until it is returned to service. Raise NoTransitionError."""
    if facts.out_of_service:
        raise NoTransitionError
    return _moved(facts, replace(facts, out_of_service=True), "remove", at)


def return_to_service(facts: AlarmFacts, _: AlarmAttributes, at: UnixTime) -> Changed:
    """Annunciate an alarm again. Raise NoTransitionError."""
    if not facts.out_of_service:
        raise NoTransitionError
    return _shown(facts, replace(facts, out_of_service=False), "return", at)


def suppress(facts: AlarmFacts, suppressed: bool, at: UnixTime) -> Changed:
    """Begin or end the suppression by design; no transition if nothing changes."""
    if facts.suppressed == suppressed:
        return facts, ()
    after = replace(facts, suppressed=suppressed)
    return _moved(facts, after, "suppress", at) if suppressed else _shown(facts, after, "unsuppress", at)


def withdraw(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    """Lead an alarm whose definition ends to normal: it ends out of service, and then returns. Nothing is
    annunciated on the way. An alarm that is normal has no transition."""
    facts = replace(facts, changing_since=None, unknown_since=None)
    if facts.state == "normal":
        return facts, ()
    steps: list[Transition] = []

    def follow(changed: Changed) -> AlarmFacts:
        steps.extend(changed[1])
        return changed[0]

    if not facts.out_of_service:
        facts = follow(remove_from_service(facts, attributes, at))
    if facts.active:
        facts = follow(_cleared(facts, attributes, at))
    if facts.latched and not facts.acknowledged:
        facts = follow(_acknowledged(facts, at))
    if facts.latched:
        facts = follow(_reset(facts, at))
    if facts.shelved_until is not None:
        facts = follow(_unshelved(facts, at))
    facts = follow(suppress(facts, False, at))
    facts = follow(return_to_service(facts, attributes, at))
    return facts, tuple(steps)


def _risen(facts: AlarmFacts, at: UnixTime) -> Changed:
    after = replace(
        facts,
        active=True,
        acknowledged=False,
        latched=False,
        occurrence=facts.occurrence + 1,
        came=at,
        cleared=None,
        acknowledged_at=None,
    )
    return _moved(facts, after, "rise", at)


def _cleared(facts: AlarmFacts, attributes: AlarmAttributes, at: UnixTime) -> Changed:
    after = replace(facts, active=False, latched=attributes.latching, cleared=at)
    return _moved(facts, after, "clear", at)


def _acknowledged(facts: AlarmFacts, at: UnixTime) -> Changed:
    return _moved(facts, replace(facts, acknowledged=True, acknowledged_at=at), "acknowledge", at)


def _reset(facts: AlarmFacts, at: UnixTime) -> Changed:
    return _moved(facts, replace(facts, latched=False), "reset", at)


def _unshelved(facts: AlarmFacts, at: UnixTime) -> Changed:
    return _shown(facts, replace(facts, shelved_until=None, shelved_once=False), "unshelve", at)


def _shown(before: AlarmFacts, after: AlarmFacts, trigger: AlarmTrigger, at: UnixTime) -> Changed:
    """End one of the reasons that hide an alarm. An alarm that nothing hides any more comes back as normal
    or, while it is active or latched, unacknowledged (G, H, I → A or B)."""
    if not after.is_hidden:
        is_over = not (after.active or after.latched)
        after = replace(
            after, acknowledged=is_over, acknowledged_at=after.acknowledged_at if is_over else None
        )
    return _moved(before, after, trigger, at)


def _moved(before: AlarmFacts, after: AlarmFacts, trigger: AlarmTrigger, at: UnixTime) -> Changed:
    if after.state != before.state:
        after = replace(after, since=at, silenced=after.silenced and trigger == "clear")
    return after, (Transition(at, trigger, after.occurrence, before.state, after.state),)


@dataclass(frozen=True, slots=True)
class LimitRule:
    """A limit with a deadband. ``above`` and ``below``: where the condition begins; None: no such limit."""

    above: int | None
    below: int | None
    deadband: int = 0

    def holds(self, value: int, active: bool) -> bool:
        """Return whether a value is beyond a limit. An active condition ends only when the value is back by
        more than the deadband."""
        deadband = self.deadband if active else 0
        if self.above is not None and value > self.above - deadband:
            return True
        return self.below is not None and value < self.below + deadband


@lru_cache(1024)  # Decimals cost 4 µs with each value of each unit
def limits_of(tuning: Tuning, full_scale: int) -> LimitRule:
    """Return the limits of an alarm in the counts of its value."""

    def raw(percent: Decimal | None) -> int | None:
        return None if percent is None else round(percent * full_scale / 100)

    above, below = raw(tuning.above_percent), raw(tuning.below_percent)
    return LimitRule(max(1, above or 0), below, raw(tuning.deadband_percent) or 0)


@dataclass(slots=True)
class ChangeRate:
    """The rate of change of a value, over at least ``SPAN_S`` seconds."""

    SPAN_S = 1.0
    _at: float | None = None
    _value: int = 0
    _per_s: float | None = None

    def see(self, value: int, at: float) -> float | None:
        """Return the change per second up to a reading; None while it is not known."""
        if self._at is None or at < self._at:
            self._at, self._value = at, value
        elif at - self._at >= self.SPAN_S:
            self._per_s = abs(value - self._value) / (at - self._at)
            self._at, self._value = at, value
        return self._per_s

    def forget(self) -> None:
        """Forget the rate: the value was not known for a while."""
        self._at = self._per_s = None


COUNTED_S = 60.0


@dataclass(slots=True)
class CountWindow:
    """The counts of a total and its faults in the last window of a minute; None until one is over."""

    total: int | None = None
    faults: int | None = None
    _at: UnixTime | None = None
    _from: tuple[int, int] = (0, 0)

    def judged(self, holds: CountPredicate) -> bool | None:
        """Return whether a condition holds by the last window; None until one is over."""
        return None if self.total is None or self.faults is None else holds(self.total, self.faults)

    def restart(self) -> None:
        """Restart the count with the next counters."""
        self._at = None

    def see(self, total: int, faults: int, at: UnixTime) -> None:
        """Add the present counters. Those of a worker that was restarted begin at zero."""
        is_restarted = total < self._from[0] or faults < self._from[1]
        if self._at is None or is_restarted or at < self._at:
            self._at, self._from = at, (total, faults)
        elif at - self._at >= COUNTED_S:
            self.total, self.faults = total - self._from[0], faults - self._from[1]
            self._at, self._from = at, (total, faults)


DISTURBANCE_S = 5.0
"""The seconds within which alarms that rise after the first belong to one disturbance."""


@dataclass(slots=True)
class FirstOut:
    """The alarms of the present disturbance of one bus, in the order in which they came. Alarms about
    parameters are not added: they come when a parameter is read, not when it was changed."""

    _alarms: dict[str, None] = field(default_factory=dict)
    _at: UnixTime = UnixTime(0.0)

    def rise(self, alarm: str, at: UnixTime) -> tuple[str, int]:
        """Add an alarm that is annunciated. Return the first of its disturbance, and how many there are."""
        if not self._alarms or not 0 <= at - self._at <= DISTURBANCE_S:
            self._alarms, self._at = {}, at
        self._alarms[alarm] = None
        return next(iter(self._alarms)), len(self._alarms)


@dataclass(frozen=True, slots=True)
class Suppressors:
    """The conditions of one bus that suppress alarms now."""

    groups: Collection[SuppressionGroup] = ()
    """The groups that conditions of the bus suppress."""
    at_rest: bool = False
    estops: Collection[int] = ()
    """The units whose emergency stop is active."""

    def suppress(self, group: SuppressionGroup | None, unit: int | None) -> bool:
        """Return whether an alarm of this group and unit is suppressed."""
        return group in self.groups or (group == "speed" and (self.at_rest or unit in self.estops))


def is_at_rest(commanded: Iterable[int | None]) -> bool:
    """Return whether zero is commanded to every unit; a unit that was never read is no proof of rest."""
    speeds = list(commanded)
    return bool(speeds) and all(speed == 0 for speed in speeds)
