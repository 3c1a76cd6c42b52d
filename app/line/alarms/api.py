"""Alarms over HTTP: what is present, what people do with it, and the journal."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Query
from pydantic import Field
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.admission.access import Person, Viewer
from app.core.web.api.route import ApiRoute
from app.core.web.api.shape import (
    Instant,
    MaybeInstant,
    MaybeMessage,
    MessageShown,
    iso,
    maybe_shown,
    message_shown,
)
from app.core.web.services import service
from app.line.alarms.acts import ALARM_ACTS, AlarmAct
from app.line.alarms.alarm import Alarm, AlarmRationalization, BusName, UnitNumber
from app.line.alarms.journal.store import JournalEntry
from app.line.alarms.monitor.line_alarms import LineAlarms
from app.line.alarms.rules.state_machine import AlarmState, AlarmTrigger
from app.line.conditions.condition import AlarmGroup
from app.line.conditions.priority import AlarmPriority
from bus.instants import UnixTime
from bus.messages import Message, in_english

AlarmGroupShown = TypeAliasType("AlarmGroupShown", AlarmGroup)
AlarmStateShown = TypeAliasType("AlarmStateShown", AlarmState)
AlarmPriorityShown = TypeAliasType("AlarmPriorityShown", AlarmPriority)
AlarmTriggerShown = TypeAliasType("AlarmTriggerShown", AlarmTrigger)
"""Named, so that clients have one enumeration of each."""
WhenOrNull = Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: it is not.")]
CameAt = Annotated[MaybeInstant, Field(description="When its occurrence began; null: it never came.")]
ClearedAt = Annotated[MaybeInstant, Field(description="When its condition ended; null: it did not.")]
AcknowledgedAt = Annotated[MaybeInstant, Field(description="When a person acknowledged it; null: none has.")]


class AlarmShown(TypedDict):
    """One alarm and its present occurrence."""

    id: Annotated[str, Field(description="Names the occurrence: another one has another id.")]
    name: str
    code: str
    group: Annotated[AlarmGroupShown, Field(description="What it is about.")]
    bus: BusName
    unit: UnitNumber
    priority: AlarmPriorityShown
    state: AlarmStateShown
    active: Annotated[bool, Field(description="Whether its condition holds, its delays included.")]
    acknowledged: bool
    silenced: Annotated[bool, Field(description="Whether its sound was ended before its acknowledgement.")]
    since: Annotated[MaybeInstant, Field(description="When it got into its state; null: never another.")]
    came: CameAt
    cleared: ClearedAt
    acknowledged_at: AcknowledgedAt
    unknown_since: Annotated[
        MaybeInstant, Field(description="Since when its condition is not known; null: it is known.")
    ]
    value: Annotated[str | None, Field(description="The present value where it is about one.")]
    value_message: MaybeMessage
    message: Annotated[str, Field(description="What it is and what to do, English.")]
    alarm_message: MessageShown
    first_out: Annotated[bool, Field(description="It was the first of several that rose together.")]
    shelved_until: WhenOrNull
    hidden_by: Annotated[str | None, Field(description="Who shelved it or took it out of service.")]
    reason: Annotated[str | None, Field(description="Why.")]


class AlarmTransition(TypedDict):
    """One change of an alarm."""

    id: int
    time: Instant
    alarm: Annotated[str, Field(description="The id of the occurrence.")]
    name: str
    code: str
    bus: BusName
    unit: UnitNumber
    priority: AlarmPriorityShown
    trigger: AlarmTriggerShown
    before: AlarmStateShown
    after: AlarmStateShown
    who: Annotated[str | None, Field(description="The user; null: no one acted.")]
    reason: str | None


def alarm_message(alarm: Alarm, value: Message | None) -> Message:
    """Return the text of an alarm: what it is, its present value, and what to do."""
    definition = alarm.definition
    if value is None:
        return Message.of("alarm_text", name=definition.name, response=definition.record.response)
    return Message.of(
        "alarm_value_text", name=definition.name, value=value, response=definition.record.response
    )


def present_value(alarms: LineAlarms, alarm: Alarm) -> Message | None:
    """The present value of what it is about; None where it is about none, or that is not known."""
    bus = alarm.definition.bus
    return alarms.site.present(alarm) if bus is None else alarms.buses[bus].present(alarm)


def alarm_json(alarms: LineAlarms, alarm: Alarm) -> AlarmShown:
    """An alarm as it is now."""
    definition, facts = alarm.definition, alarm.facts
    value = present_value(alarms, alarm)
    message = alarm_message(alarm, value)
    hidden_by, reason = alarm.hiding
    return {
        "id": alarm.id,
        "name": str(definition.name),
        "code": definition.code,
        "group": definition.about,
        "bus": definition.bus,
        "unit": definition.unit,
        "priority": definition.priority,
        "state": facts.state,
        "active": facts.active,
        "acknowledged": facts.acknowledged,
        "silenced": facts.silenced,
        "since": _time(facts.since),
        "came": _time(facts.came),
        "cleared": _time(facts.cleared),
        "acknowledged_at": _time(facts.acknowledged_at),
        "unknown_since": _time(facts.unknown_since),
        "value": in_english(value) or None,
        "value_message": maybe_shown(value),
        "message": str(message),
        "alarm_message": message_shown(message),
        "first_out": alarm.first_out,
        "shelved_until": _time(facts.shelved_until),
        "hidden_by": hidden_by or None,
        "reason": reason or None,
    }


def transition_json(entry: JournalEntry) -> AlarmTransition:
    """An entry of the journal."""
    return {
        "id": entry.id,
        "time": iso(entry.at),
        "alarm": f"{entry.alarm}.{entry.occurrence}",
        "name": entry.name,
        "code": entry.code,
        "bus": entry.bus,
        "unit": entry.unit,
        "priority": entry.priority,
        "trigger": entry.trigger,
        "before": entry.before,
        "after": entry.after,
        "who": entry.who or None,
        "reason": entry.reason or None,
    }


def _time(at: UnixTime | None) -> str | None:
    return None if at is None else iso(at)


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
