"""When alarms were annunciated and active, from the journal, and over HTTP for charts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from heapq import merge
from itertools import islice
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.requests import Request
from typing_extensions import TypedDict

from app.core.database import StoreConnection, StoreRow
from app.core.web.admission.access import Viewer
from app.core.web.admission.turns import SEARCH
from app.core.web.api.route import ApiRoute
from app.core.web.api.shape import Instant, MaybeInstant, iso
from app.core.web.rendering.templating import templates_of
from app.line.alarms.alarm import BusName, UnitNumber
from app.line.alarms.api import AlarmPriorityShown, Alarms
from app.line.alarms.journal.store import AlarmStore, RecordedAlarm
from app.line.alarms.monitor.line_alarms import LineAlarms
from app.line.history.service import seconds
from app.line.history.spans import SpanOf
from bus.instants import UnixTime

MAX_OCCURRENCES = 500
_ACTIVE = ("unack_active", "ack_active")
_LAST = (
    "SELECT MAX(id) FROM (SELECT id FROM alarm_journal WHERE at < ? ORDER BY at DESC LIMIT 1000) AS newest"
)
"""The newest transition before a time. Transitions of several buses are in order but for moments."""


@dataclass(frozen=True, slots=True)
class Occurrence(RecordedAlarm):
    """An alarm was annunciated at ``start`` and active until ``end``; None: it still is. One during which the
    clock was set back by more than it had lasted ends at its start."""

    start: UnixTime
    end: UnixTime | None


_COLUMNS = tuple(field.name for field in fields(RecordedAlarm))
_EDGE = f"((before IN {_ACTIVE}) <> (after IN {_ACTIVE}))"
"""An occurrence begins or ends; as the partial index ``alarm_journal_edges`` has it."""
_BACKWARD = (
    "SELECT * FROM alarm_journal INDEXED BY alarm_journal_edges"
    f" WHERE alarm = ? AND id < ? AND {_EDGE} ORDER BY id DESC LIMIT ?"
)
_NEXT = (
    "SELECT at FROM alarm_journal INDEXED BY alarm_journal_edges"
    f" WHERE alarm = ? AND id > ? AND {_EDGE} ORDER BY id LIMIT 1"
)
_FEW, _MANY = 2, 100
"""Rows of a read, the first and each further one: of most alarms only the newest occurrence is needed."""


async def occurrences(
    store: AlarmStore, alarms: Iterable[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    """Occurrences of a span, also where they began before it; of more than MAX_OCCURRENCES the newest and one
    more, oldest first. ``alarms``: their keys."""
    keys = list(alarms)
    return await store.read_costly(lambda connection: _found(connection, keys, start, end))


def _found(
    connection: StoreConnection, alarms: list[str], start: UnixTime, end: UnixTime
) -> list[Occurrence]:
    last: int = connection.execute(_LAST, (end,)).fetchone()[0] or 0
    each_alarm = (_of_alarm(connection, alarm, last, start, end) for alarm in alarms)
    newest_first = merge(*each_alarm, key=lambda each: each.start, reverse=True)
    return sorted(islice(newest_first, MAX_OCCURRENCES + 1), key=lambda each: each.start)


def _of_alarm(
    connection: StoreConnection, alarm: str, last: int, start: UnixTime, end: UnixTime
) -> Iterator[Occurrence]:
    """Yield the occurrences of one alarm, from the newest back to the one at the start of the span."""
    until, is_first = None, True
    for row in _edges(connection, alarm, last):
        if row["after"] not in _ACTIVE:
            until = row["at"]
            if until <= start:
                return
        else:
            if is_first:
                until = _next_end(connection, alarm, last)
            if row["at"] < end:
                yield _occurrence(row, until)
        is_first = False


def _edges(connection: StoreConnection, alarm: str, last: int) -> Iterator[StoreRow]:
    """Where occurrences begin and end, from an entry of the journal back. None is kept open between two."""
    before, limit = last + 1, _FEW
    while rows := connection.execute(_BACKWARD, (alarm, before, limit)).fetchall():
        yield from rows
        before, limit = rows[-1]["id"], _MANY


def _next_end(connection: StoreConnection, alarm: str, last: int) -> UnixTime | None:
    row = connection.execute(_NEXT, (alarm, last)).fetchone()
    return None if row is None else row[0]


def _occurrence(row: StoreRow, end: UnixTime | None) -> Occurrence:
    ends = None if end is None else max(row["at"], end)
    return Occurrence(start=row["at"], end=ends, **{name: row[name] for name in _COLUMNS})


router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

MAX_UNITS = 255


class AlarmOccurrenceText(TypedDict):
    """In the reader's language."""

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
    """When alarms were annunciated and active in a span: those of each ``bus/unit`` named and of its bus, or
    all. At most the newest 500. What was hidden all the time is in the journal alone."""
    keys = _keys(alarms, unit or [])
    found = await occurrences(alarms.store, keys, seconds(span.start), seconds(span.end))
    language = templates_of(request).language_of(request)

    def shown(each: Occurrence) -> AlarmOccurrence:
        return {
            "alarm": f"{each.alarm}.{each.occurrence}",
            "name": each.name,
            "code": each.code,
            "bus": each.bus,
            "unit": each.unit,
            "priority": each.priority,
            "from": iso(each.start),
            "to": None if each.end is None else iso(each.end),
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
