"""Alarms over HTTP: what is present, what people do with it, and the journal."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from app.alarms.group import AlarmGroup, group_of
from app.alarms.line_alarms import LineAlarms
from app.alarms.rules.states import AlarmState
from app.alarms.shown import (
    AlarmRationalization,
    AlarmShown,
    AlarmTransition,
    alarm_json,
    record_json,
    transition_json,
)
from app.conditions.priority import AlarmPriority
from app.web.access import Engineer, Operator, Viewer
from app.web.api_route import ApiRoute
from app.web.services import service
from app.web.shape import StrictBody
from bus.text import OneLine

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_MINUTES = 720
"""A shift: what is to be hidden longer goes out of service."""
MAX_ENTRIES = 1000
Alarms = Annotated[LineAlarms, service(LineAlarms)]
ActReason = Annotated[OneLine, Field(min_length=1, max_length=200)]
Comment = Annotated[OneLine, Field(max_length=200)]


class ActBody(StrictBody):
    """What a person writes loses the blanks around it."""

    model_config = ConfigDict(str_strip_whitespace=True)


class AlarmCommentRequest(ActBody):
    """A remark for the journal and the audit log."""

    comment: Comment = ""


class AlarmShelveRequest(ActBody):
    """Why, and for how long."""

    reason: ActReason
    minutes: Annotated[int, Field(ge=1, le=MAX_MINUTES, description="At most a shift, 720.")]
    once: Annotated[bool, Field(description="Or until its condition has ended, if that is sooner.")] = False


class AlarmReturnRequest(ActBody):
    """Why, for the journal and the audit log."""

    reason: Comment = ""


class AlarmOutOfServiceRequest(ActBody):
    """Why."""

    reason: ActReason


class AlarmsShown(TypedDict):
    """Alarms: active before cleared, those that wait for an acknowledgement before acknowledged ones, then by
    priority, the newest first; hidden ones last."""

    alarms: list[AlarmShown]


class AlarmDetail(TypedDict):
    """One alarm, its record, and its newest transitions."""

    alarm: AlarmShown
    record: AlarmRationalization
    transitions: list[AlarmTransition]


class AlarmJournal(TypedDict):
    """Transitions, newest first. ``next`` is the ``before`` of the next page, null at the end."""

    transitions: list[AlarmTransition]
    next: int | None


@router.get("")
async def get_alarms(
    _: Viewer,
    alarms: Alarms,
    state: AlarmState | None = None,
    priority: AlarmPriority | None = None,
    bus: str | None = None,
    unit: Annotated[int | None, Query(ge=1, le=255)] = None,
    group: AlarmGroup | None = None,
) -> AlarmsShown:
    """All alarms that are not normal, or those in one state; ``normal`` is one of them."""
    found = [
        alarm
        for alarm in (alarms.every() if state == "normal" else alarms.present())
        if state in (None, alarm.facts.state)
        and priority in (None, alarm.definition.priority)
        and bus in (None, alarm.definition.bus)
        and unit in (None, alarm.definition.unit)
        and group in (None, group_of(alarm.definition))
    ]
    return {"alarms": [alarm_json(alarms, alarm) for alarm in found]}


@router.get("/journal")
async def get_alarm_journal(
    _: Viewer,
    alarms: Alarms,
    limit: Annotated[int, Query(ge=1, le=MAX_ENTRIES)] = 100,
    before: Annotated[int | None, Query(ge=1, le=2**62)] = None,
) -> AlarmJournal:
    """Every transition, also of what was shelved, suppressed or out of service."""
    entries = await alarms.store.journal(limit + 1, before)
    following = entries[limit - 1].id if len(entries) > limit else None
    return {"transitions": [transition_json(entry) for entry in entries[:limit]], "next": following}


@router.get("/{alarm_id}")
async def get_alarm(_: Viewer, alarms: Alarms, alarm_id: str) -> AlarmDetail:
    """One alarm with the record of its rationalization and its last transitions."""
    alarm = alarms.find(alarm_id).alarm
    entries = await alarms.store.journal_of(alarm.definition.key, 100)
    return {
        "alarm": alarm_json(alarms, alarm),
        "record": record_json(alarm.definition.record),
        "transitions": [transition_json(entry) for entry in entries],
    }


@router.post("/{alarm_id}/acknowledge")
async def acknowledge_alarm(
    person: Operator, alarms: Alarms, alarm_id: str, body: AlarmCommentRequest | None = None
) -> AlarmShown:
    """Acknowledge the occurrence that the id names."""
    comment = "" if body is None else body.comment
    return alarm_json(alarms, await alarms.acknowledge(person, alarm_id, comment))


@router.post("/{alarm_id}/silence")
async def silence_alarm(
    person: Operator, alarms: Alarms, alarm_id: str, body: AlarmCommentRequest | None = None
) -> AlarmShown:
    """End the sound of the occurrence that the id names. It is still to be acknowledged."""
    comment = "" if body is None else body.comment
    return alarm_json(alarms, await alarms.silence(person, alarm_id, comment))


@router.post("/{alarm_id}/reset")
async def reset_alarm(
    person: Operator, alarms: Alarms, alarm_id: str, body: AlarmCommentRequest | None = None
) -> AlarmShown:
    """Reset an acknowledged alarm that is latched."""
    comment = "" if body is None else body.comment
    return alarm_json(alarms, await alarms.reset(person, alarm_id, comment))


@router.post("/{alarm_id}/shelve")
async def shelve_alarm(
    person: Operator, alarms: Alarms, alarm_id: str, body: AlarmShelveRequest
) -> AlarmShown:
    """Hide it until a time. It is still detected and recorded."""
    alarm = await alarms.shelve(person, alarm_id, body.reason, body.minutes, once=body.once)
    return alarm_json(alarms, alarm)


@router.post("/{alarm_id}/unshelve")
async def unshelve_alarm(
    person: Operator, alarms: Alarms, alarm_id: str, body: AlarmReturnRequest | None = None
) -> AlarmShown:
    """Annunciate it again before its time."""
    reason = "" if body is None else body.reason
    return alarm_json(alarms, await alarms.unshelve(person, alarm_id, reason))


@router.post("/{alarm_id}/out-of-service")
async def remove_alarm_from_service(
    person: Engineer, alarms: Alarms, alarm_id: str, body: AlarmOutOfServiceRequest
) -> AlarmShown:
    """Hide it until it is returned to service. It is still detected and recorded."""
    return alarm_json(alarms, await alarms.remove(person, alarm_id, body.reason))


@router.post("/{alarm_id}/in-service")
async def return_alarm_to_service(
    person: Engineer, alarms: Alarms, alarm_id: str, body: AlarmReturnRequest | None = None
) -> AlarmShown:
    """Annunciate it again."""
    reason = "" if body is None else body.reason
    return alarm_json(alarms, await alarms.return_(person, alarm_id, reason))
