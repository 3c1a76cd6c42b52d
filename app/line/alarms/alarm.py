"""Alarms: their definitions, among them the built-in ones, and the state of an alarm at run time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from typing import Annotated

from pydantic import Field
from typing_extensions import TypeAliasType

from app.core.web.shape import MessageObject
from app.line.alarms.rules import AlarmAttributes, AlarmFacts, AlarmState
from app.line.alarms.settings import BuiltInAlarmSettings, tuning_of
from app.line.conditions.catalogue import CONDITIONS
from app.line.conditions.condition import (
    AlarmGroup,
    AlarmPriority,
    Consequence,
    SuppressionGroup,
    TimeToRespond,
    Tuning,
)
from bus.instants import UnixTime
from bus.messages import Message

BusName = Annotated[str | None, Field(description="null: it belongs to the site.")]
UnitNumber = Annotated[int | None, Field(description="Address of the unit (#17), 1 to 255; null: the bus.")]
AlarmConsequence = TypeAliasType("AlarmConsequence", Consequence)
AlarmTimeToRespond = TypeAliasType("AlarmTimeToRespond", TimeToRespond)
SITE = "_"
"""The place in the key of an alarm of the site, instead of a bus, whose name has no underscore."""


@dataclass(frozen=True, slots=True)
class AlarmRationalization:
    """The reason for an alarm, and what a person does about it (ISA-18.2-2016, clause 9)."""

    cause: MessageObject
    consequence: MessageObject
    response: MessageObject
    severity: AlarmConsequence
    time_to_respond: AlarmTimeToRespond


@dataclass(frozen=True, slots=True)
class AlarmDefinition:
    """An alarm of a unit, a bus or the site. ``key`` identifies it for good, even after a restart."""

    key: str
    code: str
    name: str | Message
    bus: str | None
    unit: int | None
    priority: AlarmPriority
    record: AlarmRationalization
    attributes: AlarmAttributes
    group: SuppressionGroup | None = None
    about: AlarmGroup = "own"


def alarm_key(bus: str | None, unit: int | None, code: str) -> str:
    """Return the key of an alarm: its place and its code."""
    return ".".join((bus or SITE, *(() if unit is None else (str(unit),)), code))


def own_key(bus: str, unit: int, name: str) -> str:
    """Return the key of an alarm that the site defined, whose name may have any characters."""
    return alarm_key(bus, unit, f"own-{blake2b(name.encode(), digest_size=6).hexdigest()}")


NORMAL = AlarmFacts()
"""The facts of an alarm that has not risen yet."""


def state_text(state: AlarmState) -> Message:
    """Return the words for a state."""
    return Message(f"alarm_state_{state}")


@dataclass(slots=True, eq=False)
class Alarm:
    """An alarm and its state."""

    definition: AlarmDefinition
    facts: AlarmFacts = NORMAL
    holds: bool | None = None
    """Whether the condition held when last observed; None: not known."""
    first_out: int = 0
    """The number of alarms that rose together, where this was the first of them; else 0."""
    hidden_by: str = ""
    """The person who shelved the alarm or took it out of service."""
    reason: str = ""
    """The reason for which the alarm is hidden."""

    @property
    def id(self) -> str:
        """The id of the present occurrence."""
        return f"{self.definition.key}.{self.facts.occurrence}"

    @property
    def is_unacknowledged(self) -> bool:
        """Whether the alarm waits for its acknowledgement, and nothing hides it."""
        return not self.facts.is_hidden and not self.facts.acknowledged

    @property
    def again_since(self) -> UnixTime | None:
        """The time since which an active alarm waits to be acknowledged, if that is later than it came: what
        hid it ended, or it was annunciated again. None: since it came."""
        facts = self.facts
        return facts.since if self.is_unacknowledged and facts.active and facts.since != facts.came else None

    @property
    def state_at(self) -> UnixTime | None:
        """Return the time of the present state: when a cleared alarm cleared, since when an unknown one is
        unknown, else when it came."""
        facts = self.facts
        at = (facts.unknown_since or facts.came) if facts.active else facts.cleared
        return at or facts.since

    @property
    def is_annunciated(self) -> bool:
        """Whether the alarm is active or not acknowledged, and nothing hides it."""
        return not self.facts.is_hidden and (self.facts.active or not self.facts.acknowledged)

    @property
    def is_unknown(self) -> bool:
        """Whether the alarm was active and may have ended since, as its condition is not observed. What
        suppresses it, as a closed port does, may be why; one that a person hid is left out."""
        facts = self.facts
        return facts.active and facts.unknown_since is not None and not facts.is_hidden_by_person

    @property
    def state_text(self) -> Message:
        """The words for the present state."""
        return state_text(self.facts.state)

    @property
    def hiding(self) -> tuple[str, str]:
        """The person who hides the alarm, and the reason; both empty if no one does."""
        return (self.hidden_by, self.reason) if self.facts.is_hidden_by_person else ("", "")

    @property
    def mark(self) -> str:
        """The shape in which the alarm is drawn: its priority, with ``cleared`` once its condition has ended
        and ``waiting`` until it is acknowledged."""
        cleared = "" if self.facts.active else " cleared"
        return self.definition.priority + cleared + (" waiting" if self.is_unacknowledged else "")


def built_in(
    code: str, bus: str | None, unit: int | None = None, tuned: Iterable[BuiltInAlarmSettings] = ()
) -> AlarmDefinition:
    """Return a built-in alarm at its place. ``tuned``: the limits and delays that the site set."""
    row = CONDITIONS[code]
    name, record = _texts(code)
    usual: AlarmGroup = "drive" if unit is not None else "system" if bus is None else "communication"
    return AlarmDefinition(
        key=alarm_key(bus, unit, code),
        code=code,
        name=name,
        bus=bus,
        unit=unit,
        priority=row.priority,
        record=record,
        attributes=_attributes(tuning_of(tuned, code, bus, unit), row.latching),
        group=row.group,
        about=row.about or usual,
    )


@cache
def _texts(code: str) -> tuple[Message, AlarmRationalization]:
    """Return the texts of a built-in alarm, the same objects for every unit: a line has thousands of
    alarms."""
    row = CONDITIONS[code]
    name, cause, consequence, response = map(Message, row.texts)
    return name, AlarmRationalization(cause, consequence, response, *row.rated)


@cache
def _attributes(tuning: Tuning, latching: bool) -> AlarmAttributes:
    return AlarmAttributes(tuning.on_delay_s, tuning.off_delay_s, latching=latching)
