"""What an alarm is, apart from how it is now."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import Annotated

from pydantic import Field
from typing_extensions import TypeAliasType

from app.alarms.rules.facts import AlarmAttributes
from app.conditions.condition import AlarmGroup, SuppressionGroup
from app.conditions.priority import AlarmPriority, Consequence, TimeToRespond
from app.web.shape import MessageObject
from bus.messages import Message

BusName = Annotated[str | None, Field(description="null: it belongs to the site.")]
UnitNumber = Annotated[int | None, Field(description="Address of the unit (#17), 1 to 255; null: the bus.")]
AlarmConsequence = TypeAliasType("AlarmConsequence", Consequence)
AlarmTimeToRespond = TypeAliasType("AlarmTimeToRespond", TimeToRespond)
SITE = "_"
"""In a key in place of a bus (a slug holds no underscore): the alarm belongs to the site."""


@dataclass(frozen=True, slots=True)
class AlarmRationalization:
    """Why there is this alarm and what a person does about it (ISA-18.2-2016, clause 9)."""

    cause: MessageObject
    consequence: MessageObject
    response: MessageObject
    severity: AlarmConsequence
    time_to_respond: AlarmTimeToRespond


@dataclass(frozen=True, slots=True)
class AlarmDefinition:
    """One alarm of a unit, a bus or the site. ``key`` identifies it for good, also after a restart."""

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


def key_of(bus: str | None, unit: int | None, code: str) -> str:
    """The key of a built-in alarm."""
    return ".".join((bus or SITE, *(() if unit is None else (str(unit),)), code))


def own_key(bus: str, unit: int, name: str) -> str:
    """The key of an alarm of the site, whose name may have any characters."""
    return key_of(bus, unit, f"own-{blake2b(name.encode(), digest_size=6).hexdigest()}")
