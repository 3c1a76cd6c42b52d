"""``/api/v1/alarms/own``: the site's own alarms, listed, added, changed and removed."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query
from pydantic import Field
from typing_extensions import TypedDict

from app.alarms.api import ActReason, Comment
from app.alarms.own_book import OwnAlarm, OwnAlarmBook
from app.alarms.settings import AlarmSettings, OwnValue
from app.alarms.shown import AlarmPriorityShown
from app.alarms.simulation.api import WrittenAlarmBody, WrittenDelay
from app.web.access import Engineer
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
    reason: Annotated[str, Field(description="Why, English.")]
    reason_message: MessageShown


class OwnAlarmsShown(TypedDict):
    """Those of the configuration, those that were added, and those that do not fit."""

    alarms: list[OwnAlarmShown]
    left_aside: list[OwnAlarmLeftAside]


@router.get("")
async def get_own_alarms(_: Engineer, own: OwnBook) -> OwnAlarmsShown:
    """The alarms of the site, with their origin."""
    configured = [_shown(key, settings, None) for key, settings in own.configured.items()]
    return {
        "alarms": configured + [own_alarm_json(each) for each in own.added.values()],
        "left_aside": [
            {
                "id": each.key,
                "name": each.name,
                "version": each.version,
                "reason": str(each.why),
                "reason_message": message_shown(each.why),
            }
            for each in own.left_aside.values()
        ],
    }


@router.post("", status_code=201)
async def add_own_alarm(
    person: Engineer, own: OwnBook, body: OwnAlarmRequest, key: RequestKey = None
) -> OwnAlarmShown:
    """Add an alarm. It is detected from the next reading on."""
    return own_alarm_json(await own.add(person, _written(body), key))


@router.put("/{own_id}")
async def change_own_alarm(
    person: Engineer, own: OwnBook, own_id: OwnAlarmKey, body: OwnAlarmChangeRequest
) -> OwnAlarmShown:
    """Change an alarm that was added. One that is active ends, and comes again by the next reading."""
    return own_alarm_json(await own.change(person, own_id, body.version, _written(body), body.reason))


@router.delete("/{own_id}", status_code=204)
async def remove_own_alarm(
    person: Engineer,
    own: OwnBook,
    own_id: OwnAlarmKey,
    version: Annotated[int, Query(ge=1, le=2**62, description="That was seen.")],
    reason: Annotated[ActReason, Query(description="For the journal and the audit log.")],
) -> None:
    """Remove an alarm that was added. One that is active ends."""
    await own.remove(person, own_id, version, reason)


def _written(body: OwnAlarmRequest) -> dict[str, Any]:
    fields = body.model_dump(exclude_unset=True, exclude={"version", "reason"})
    return {key: value for key, value in fields.items() if value is not None}


def own_alarm_json(own: OwnAlarm) -> OwnAlarmShown:
    """One that was added."""
    return _shown(own.key, own.settings, own)


def _shown(key: str, settings: AlarmSettings, own: OwnAlarm | None) -> OwnAlarmShown:
    shown: Any = {
        "id": key,
        "origin": "configuration" if own is None else "page",
        "version": None if own is None else own.version,
        "changed_by": None if own is None else own.who,
        "changed_at": None if own is None else iso(own.at),
        **settings.model_dump(mode="json"),
    }
    found: OwnAlarmShown = shown
    return found
