"""Alarms over HTTP: the present ones, what people do with them, the journal and its figures."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Body, Depends, Query
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.access import Person, Viewer
from app.core.web.api import ApiRoute
from app.core.web.csv_file import CSV, Column, WantedCsv
from app.core.web.request_rules import refuse_year
from app.core.web.routes import SEARCH
from app.core.web.services import service
from app.core.web.shape import (
    Instant,
    MaybeInstant,
    MaybeMessage,
    MessageShown,
    ZonedTime,
    attachment,
    iso,
    maybe_shown,
    message_shown,
)
from app.core.web.templating import templates_of
from app.errors import Problem
from app.line.alarms.acts import ALARM_ACTS, AlarmAct
from app.line.alarms.alarm import Alarm, AlarmRationalization, BusName, UnitNumber
from app.line.alarms.journal import MAX_OCCURRENCES, AlarmPerformance, JournalEntry, Occurrence, occurrences
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.rules import AlarmState, AlarmTrigger
from app.line.conditions.condition import AlarmGroup, AlarmPriority
from app.line.history.api import SpanOf
from app.line.history.service import seconds
from bus.instants import DAY_S, UnixTime, unix_now
from bus.messages import Message, in_english, term

AlarmGroupShown = TypeAliasType("AlarmGroupShown", AlarmGroup)
AlarmStateShown = TypeAliasType("AlarmStateShown", AlarmState)
AlarmPriorityShown = TypeAliasType("AlarmPriorityShown", AlarmPriority)
AlarmTriggerShown = TypeAliasType("AlarmTriggerShown", AlarmTrigger)
"""The types of the API's enumerations, named so that clients have one of each."""
WhenOrNull = Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: it is not.")]
CameAt = Annotated[MaybeInstant, Field(description="When its occurrence began; null: it never came.")]
ClearedAt = Annotated[MaybeInstant, Field(description="When its condition ended; null: it did not.")]
AcknowledgedAt = Annotated[MaybeInstant, Field(description="When a person acknowledged it; null: none has.")]


class AlarmShown(TypedDict):
    """An alarm and its present occurrence."""

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
    """A change of an alarm."""

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
    """Return the present value of an alarm; None if it is about no value, or that is not known."""
    bus = alarm.definition.bus
    return alarms.site.present(alarm) if bus is None else alarms.buses[bus].present(alarm)


def alarm_json(alarms: LineAlarms, alarm: Alarm) -> AlarmShown:
    """Return an alarm in the form of the API."""
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
        "first_out": alarm.first_out > 0,
        "shelved_until": _time(facts.shelved_until),
        "hidden_by": hidden_by or None,
        "reason": reason or None,
    }


def transition_json(entry: JournalEntry) -> AlarmTransition:
    """Return an entry of the journal in the form of the API."""
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
    """An alarm, its record, and its newest transitions."""

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
    """List the alarms that are not normal, or those in one state, which may be ``normal``."""
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
    """List every transition, even of alarms that were shelved, suppressed or out of service."""
    entries = await alarms.store.journal(limit + 1, before)
    following = entries[limit - 1].id if len(entries) > limit else None
    return {"transitions": [transition_json(entry) for entry in entries[:limit]], "next": following}


MAX_UNITS = 255


class AlarmOccurrenceText(TypedDict):
    """The texts of an occurrence in the reader's language."""

    name: str
    place: str


AlarmOccurrence = TypedDict(
    "AlarmOccurrence",
    {
        "alarm": Annotated[str, Field(description="The id of the occurrence.")],
        "name": str,
        "code": str,
        "bus": BusName,
        "unit": UnitNumber,
        "priority": AlarmPriorityShown,
        "from": Annotated[Instant, Field(description="When it was annunciated, ISO 8601.")],
        "to": Annotated[MaybeInstant, Field(description="Until when it was active; null: it still is.")],
        "shown": AlarmOccurrenceText,
    },
)


class AlarmOccurrences(TypedDict):
    """Occurrences of a span, oldest first."""

    occurrences: list[AlarmOccurrence]
    more: Annotated[bool, Field(description="Whether there are more than the newest 500.")]


@router.get("/occurrences", dependencies=[SEARCH])
async def get_alarm_occurrences(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    span: SpanOf,
    unit: Annotated[list[str] | None, Query(max_length=MAX_UNITS)] = None,
) -> AlarmOccurrences:
    """List when alarms were annunciated and active in a span: those of each ``bus/unit`` named and of its
    bus, or all. At most the newest 500. Alarms that were hidden all the time are in the journal only."""
    keys = _keys(alarms, unit or [])
    found = await occurrences(alarms.store, keys, seconds(span.start), seconds(span.end))
    language = templates_of(request).language_of(request)
    # Shelving ends what is annunciated, and not what is active.
    hidden = {alarm.id for alarm in alarms.every() if alarm.facts.active and alarm.facts.is_hidden}

    def shown(each: Occurrence) -> AlarmOccurrence:
        is_active = each.end is None or f"{each.alarm}.{each.occurrence}" in hidden
        return {
            "alarm": f"{each.alarm}.{each.occurrence}",
            "name": each.name,
            "code": each.code,
            "bus": each.bus,
            "unit": each.unit,
            "priority": each.priority,
            "from": iso(each.start),
            "to": None if is_active or each.end is None else iso(each.end),
            "shown": {"name": language.t(each.shown_name), "place": alarms.place(each.bus, each.unit)},
        }

    newest = found[-MAX_OCCURRENCES:]
    return {"occurrences": [shown(each) for each in newest], "more": len(found) > len(newest)}


def _keys(alarms: LineAlarms, units: list[str]) -> list[str]:
    buses = {unit.rpartition("/")[0] for unit in units}

    def concerns(bus: str | None, unit: int | None) -> bool:
        return not units or (bus in buses if unit is None else f"{bus}/{unit}" in units)

    definitions = (alarm.definition for alarm in alarms.every())
    return [each.key for each in definitions if concerns(each.bus, each.unit)]


MAX_DAYS = 31
USUAL_DAYS = 7
COLUMNS = (
    *(Column("code", term("Figure")), Column("value", term("Value")), Column("at_most", term("At most"))),
    *(Column("at_least", term("At least")), Column("met", term("Target met"))),
    *(Column("from", term("From"), is_time=True), Column("to", term("To"), is_time=True)),
    Column("observed_s", term("Observed (s)")),
)


def month_at_most(since: datetime | None, until: datetime | None) -> tuple[UnixTime, UnixTime]:
    """Return the span from ``since`` to ``until``, by default the last week. Raise Problem 422 for one that
    is reversed or too long."""
    for name, at in (("from", since), ("to", until)):
        if at is not None:
            refuse_year(at, name)
    end = unix_now() if until is None else UnixTime(until.timestamp())
    start = end - USUAL_DAYS * DAY_S if since is None else UnixTime(since.timestamp())
    if start >= end:
        raise Problem(422, "invalid", Message("span_reversed"))
    if end - start > MAX_DAYS * DAY_S:
        raise Problem(422, "invalid", Message.of("alarm_span_too_long", days=MAX_DAYS))
    return start, end


async def wanted_performance(
    alarms: Alarms,
    since: Annotated[ZonedTime | None, Query(alias="from")] = None,
    until: Annotated[ZonedTime | None, Query(alias="to")] = None,
) -> AlarmPerformance:
    """Measure the alarm system over the span of a request."""
    return await alarms.measure(*month_at_most(since, until))


WantedPerformance = Annotated[AlarmPerformance, Depends(wanted_performance)]


@router.get("/performance")
async def get_alarm_performance(_: Viewer, performance: WantedPerformance) -> AlarmPerformance:
    """Return the figures of ISA-18.2, clause 16, each against its target."""
    return performance


@router.get("/performance.csv", response_class=Response, responses=CSV)
async def get_alarm_performance_csv(_: Viewer, performance: WantedPerformance, form: WantedCsv) -> Response:
    """Return the figures of ISA-18.2, clause 16, as CSV, a row for each."""
    start, end = (datetime.fromtimestamp(float(at), UTC) for at in (performance.start, performance.end))
    rows = (
        (
            *(figure.code if form.language is None else Message(f"alarm_figure_{figure.code}"), figure.value),
            *(figure.at_most, figure.at_least, figure.met, start, end, performance.observed_s),
        )
        for figure in performance.figures
    )
    text = form.head(COLUMNS) + form.rows(COLUMNS, rows)
    return Response(text, media_type="text/csv", headers=attachment("alarm-performance.csv"))


@router.get("/{alarm_id}")
async def get_alarm(_: Viewer, alarms: Alarms, alarm_id: str) -> AlarmDetail:
    """Return one alarm with the record of its rationalization and its last transitions."""
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
