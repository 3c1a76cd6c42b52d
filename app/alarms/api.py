"""Alarms over HTTP: what is present, what people do with it, and the journal."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Query
from typing_extensions import TypedDict

from app.alarms.acts import ALARM_ACTS, AlarmAct
from app.alarms.alarm import AlarmRationalization
from app.alarms.monitor.line_alarms import LineAlarms
from app.alarms.rules.states import AlarmState
from app.alarms.shown import (
    AlarmShown,
    AlarmTransition,
    alarm_json,
    transition_json,
)
from app.conditions.condition import AlarmGroup
from app.conditions.priority import AlarmPriority
from app.web.admission.access import Person, Viewer
from app.web.api.route import ApiRoute
from app.web.services import service

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_ENTRIES = 1000
Alarms = Annotated[LineAlarms, service(LineAlarms)]


class AlarmsShown(TypedDict):
    """Alarms: active before cleared, then by priority, the newest first; hidden ones last."""

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
        and group in (None, alarm.definition.about)
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
    entries = await alarms.store.journal(100, alarm=alarm.definition.key)
    return {
        "alarm": alarm_json(alarms, alarm),
        "record": alarm.definition.record,
        "transitions": [transition_json(entry) for entry in entries],
    }


def _add_route(act: AlarmAct) -> None:
    default = Body() if act.hides else None

    async def perform(
        alarms: Alarms, alarm_id: str, body: Any = default, person: Person = act.permitted
    ) -> AlarmShown:
        return alarm_json(alarms, await alarms.act(person, act, alarm_id, body))

    perform.__name__, perform.__doc__ = act.name, act.means
    perform.__annotations__["body"] = act.body if act.hides else act.body | None
    router.post(f"/{{alarm_id}}/{act.path}")(perform)


for alarm_act in ALARM_ACTS:
    _add_route(alarm_act)
