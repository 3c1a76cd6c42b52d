"""``/api/v1/alarms/own``: the site's own alarms, listed, added, changed and removed."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query
from pydantic import Field
from typing_extensions import TypedDict

from app.alarms.acts import ADD_OWN, CHANGE_OWN, REMOVE_OWN, ActReason, Comment
from app.alarms.definition import own_key
from app.alarms.own_book import OwnAlarmBook
from app.alarms.own_store import OwnAlarm
from app.alarms.settings import AlarmSettings, OwnValue
from app.alarms.shown import AlarmPriorityShown
from app.alarms.simulation.api import WrittenAlarmBody, WrittenDelay
from app.web.access import Engineer, Person
from app.web.api_route import ApiRoute, RequestKey
from app.web.services import service
from app.web.shape import MaybeInstant, MessageShown, iso, message_shown

router = APIRouter(prefix="/api/v1/alarms/own", tags=["alarms"], route_class=ApiRoute)

OwnBook = Annotated[OwnAlarmBook, service(OwnAlarmBook)]
OwnAlarmKey = Annotated[str, Path(max_length=200, description="The `id` of the list.")]
WrittenText = Annotated[str, Field(max_length=300)]
Version = Annotated[int, Field(ge=1, le=2**62, description="That the change was made from.")]
LimitShown = Annotated[str | None, Field(description="As the unit displays it; null: none.")]
DelayShown = Annotated[float, Field(description="Seconds.")]


class OwnAlarmRequest(WrittenAlarmBody):
    """An alarm as ``[[alarm]]`` of lineside.toml has it."""

    name: Annotated[str, Field(max_length=200)]
    realarm_s: WrittenDelay | None = None
    cause: WrittenText = ""
    consequence: WrittenText = ""
    response: WrittenText = ""


class OwnAlarmChangeRequest(OwnAlarmRequest):
    """The new definition; name, bus and unit stay."""

    version: Version
    reason: Comment = ""


class OwnAlarmShown(TypedDict):
    """One of them, with the keys of ``[[alarm]]``."""

    id: Annotated[str, Field(description="With its occurrence after a dot it is the id of an alarm.")]
    origin: Annotated[
        Literal["configuration", "page"], Field(description="Only those of the page are changed here.")
    ]
    version: Annotated[int | None, Field(description="Another one after each change; null: configuration.")]
    changed_by: Annotated[str | None, Field(description="null: configuration.")]
    changed_at: Annotated[MaybeInstant, Field(description="ISO 8601 in UTC; null: configuration.")]
    name: str
    bus: str
    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    value: OwnValue
    above: LimitShown
    below: LimitShown
    deadband: str
    change_per_s: LimitShown
    state: Annotated[str | None, Field(description="on or off; null: it is about a number.")]
    on_delay_s: DelayShown
    off_delay_s: DelayShown
    realarm_s: Annotated[float | None, Field(description="null: never annunciated again.")]
    priority: AlarmPriorityShown
    latch: bool
    cause: str
    consequence: str
    response: str


class OwnAlarmLeftAside(TypedDict):
    """One that does not fit the configuration; it is not observed."""

    id: str
    name: str
    version: int
    reason: Annotated[MessageShown, Field(description="Why.")]


class OwnAlarmsShown(TypedDict):
    """Those of the configuration, those that were added, and those that do not fit."""

    alarms: list[OwnAlarmShown]
    left_aside: list[OwnAlarmLeftAside]


@router.get("")
async def get_own_alarms(_: Engineer, own: OwnBook) -> OwnAlarmsShown:
    """The alarms of the site, with their origin."""
    return {
        "alarms": [own_alarm_json(*each) for each in own.every()],
        "left_aside": [
            {"id": each.key, "name": each.name, "version": each.version, "reason": message_shown(each.why)}
            for each in own.left_aside.values()
        ],
    }


@router.post("", status_code=201)
async def add_own_alarm(
    person: Annotated[Person, ADD_OWN.permitted], own: OwnBook, body: OwnAlarmRequest, key: RequestKey = None
) -> OwnAlarmShown:
    """Add an alarm. It is detected from the next reading on."""
    added = await own.add(person, body.written(), key)
    return own_alarm_json(added.settings, added)


@router.put("/{own_id}")
async def change_own_alarm(
    person: Annotated[Person, CHANGE_OWN.permitted],
    own: OwnBook,
    own_id: OwnAlarmKey,
    body: OwnAlarmChangeRequest,
) -> OwnAlarmShown:
    """Change an alarm that was added. One that is active ends, and comes again by the next reading."""
    changed = await own.change(person, own_id, body.version, body.written(), body.reason)
    return own_alarm_json(changed.settings, changed)


@router.delete("/{own_id}", status_code=204)
async def remove_own_alarm(
    person: Annotated[Person, REMOVE_OWN.permitted],
    own: OwnBook,
    own_id: OwnAlarmKey,
    version: Annotated[int, Query(ge=1, le=2**62, description="That was seen.")],
    reason: Annotated[ActReason, Query(description="For the journal and the audit log.")],
) -> None:
    """Remove an alarm that was added. One that is active ends."""
    await own.remove(person, own_id, version, reason)


def own_alarm_json(settings: AlarmSettings, own: OwnAlarm | None) -> OwnAlarmShown:
    """One of the site; ``own``: as it was added, None for one of the configuration."""
    shown: Any = {
        "id": own_key(settings.bus, settings.unit, settings.name),
        "origin": "configuration" if own is None else "page",
        "version": None if own is None else own.version,
        "changed_by": None if own is None else own.who,
        "changed_at": None if own is None else iso(own.at),
        **settings.model_dump(mode="json"),
    }
    found: OwnAlarmShown = shown
    return found
