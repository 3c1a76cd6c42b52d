"""What the store holds of a shift: alarms and blocks at its end, and the events in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, NotRequired, cast

from pydantic import Field
from typing_extensions import TypedDict

from app.core.database import StoreConnection
from app.core.database.connection import json_member
from app.core.web.api.shape import MaybeInstant, iso
from app.line.alarms.api import AlarmTransition, transition_json
from app.line.alarms.journal import JournalEntry
from app.people.audit import queries
from app.people.audit.api import EventShown, shown
from app.people.audit.log import Event
from app.people.audit.queries import Filter
from app.records.handover.rules.scope import EVERYTHING, Scope
from app.records.handover.rules.shift_times import Shift
from bus.instants import UnixTime

MAX_EVENTS = 200
"""Events of one kind on a sheet, the newest; the events page has all."""
STARTING_S = 60.0
"""An event so shortly before a start of the server belongs to that start."""
_OUTCOME = "COALESCE(f.outcome, e.outcome, '')"
_ENTRY = ", ".join(f"j.{field.name}" for field in fields(JournalEntry))
_LAST_TRANSITIONS = f"""
SELECT {_ENTRY}, (
    SELECT r.at FROM alarm_journal r WHERE r.alarm = j.alarm AND r.id <= j.id AND r.trigger = 'rise'
    ORDER BY r.id DESC LIMIT 1
) AS came FROM alarm_facts known JOIN alarm_journal j ON j.id = (
    SELECT id FROM alarm_journal WHERE alarm = known.alarm AND at < ? ORDER BY id DESC LIMIT 1
) WHERE j.after <> 'normal' ORDER BY COALESCE(came, j.at), j.id
"""
_LAST_OF_EACH = """
SELECT max(id) FROM events WHERE about IS NULL AND kind = ? AND time < ? GROUP BY bus, unit ORDER BY 1
"""
_NEXT_START = f"""
SELECT time FROM events WHERE about IS NULL AND kind = 'server' AND time >= ?
AND {json_member("messages", "what.code")} = 'event_server_started'
ORDER BY id LIMIT 1
"""
_EXTENT = "SELECT min(id), max(id) FROM events WHERE about IS NULL AND time >= ? AND time < ?"
_COUNTS = f"""
SELECT e.kind, {_OUTCOME}, count(*) FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL AND e.id BETWEEN ? AND ? AND e.time >= ? AND e.time < ?
AND e.id NOT IN (SELECT event FROM event_parts)
"""


class ShiftEventsShown(TypedDict):
    """Events of the shift: at most the newest 200, oldest first."""

    total: Annotated[int, Field(description="How many there were in all.")]
    outcomes: Annotated[dict[str, int], Field(description="How many had each outcome; empty: had none.")]
    events: list[EventShown]


class ShiftEvents:
    """Reads the events of one shift, in one transaction."""

    def __init__(self, connection: StoreConnection, shift: Shift, scope: Scope = EVERYTHING) -> None:
        self._connection = connection
        self._shift = shift
        self._scope = scope
        self._first, self._last = connection.execute(_EXTENT, (shift.start, shift.end)).fetchone()
        self._counted = self._count()

    def of(self, kinds: Sequence[str]) -> ShiftEventsShown:
        """The events of some kinds. A change of several units is one event."""
        found = [event for kind in kinds for event in self._newest(kind)]
        found.sort(key=lambda event: event["id"])
        outcomes: Counter[str] = Counter()
        for kind in kinds:
            outcomes += self._counted.get(kind, Counter())
        return {
            "total": outcomes.total(),
            "outcomes": dict(sorted(outcomes.items())),
            "events": [event_json(event) for event in found[-MAX_EVENTS:]],
        }

    def _newest(self, kind: str) -> list[Event]:
        if kind not in self._counted:
            return []
        wanted = Filter(
            before=self._last + 1,
            after=self._first - 1,
            kind=kind,
            bus=self._scope.bus,
            unit=self._scope.unit,
            since=self._shift.start,
            until=self._shift.end,
            folded=True,
        )
        return queries.select(self._connection, wanted, MAX_EVENTS)

    def _count(self) -> dict[str, Counter[str]]:
        where, values = self._scope.conditions("e.")
        bounds = (self._first or 0, self._last or 0, self._shift.start, self._shift.end, *values)
        counted: dict[str, Counter[str]] = {}
        for kind, outcome, times in self._connection.execute(f"{_COUNTS}{where} GROUP BY 1, 2", bounds):
            counted.setdefault(kind, Counter())[outcome] = times
        return counted


def event_json(event: Event) -> EventShown:
    """An event as the API has it, without the frames, which are in the events."""
    return cast(EventShown, shown({**event, "frames": "[]"}))


@dataclass(frozen=True, slots=True)
class AlarmThen(JournalEntry):
    """The last transition of an alarm before a moment, and when the alarm came; None: it never has."""

    came: UnixTime | None = None


class ShiftAlarm(AlarmTransition):
    """An alarm as it was at the end, by its last transition."""

    came: NotRequired[
        Annotated[
            MaybeInstant,
            Field(description="When it came; absent from sheets that an earlier version signed."),
        ]
    ]


def alarm_json(alarm: AlarmThen) -> ShiftAlarm:
    return {**transition_json(alarm), "came": None if alarm.came is None else iso(alarm.came)}


def alarms_at(connection: StoreConnection, at: UnixTime) -> list[AlarmThen]:
    """The last transition before a moment of each alarm that was not normal then."""
    return [AlarmThen(*row) for row in connection.execute(_LAST_TRANSITIONS, (at,))]


def last_events(connection: StoreConnection, kind: str, before: UnixTime) -> list[Event]:
    """The last event of a kind before a moment, for each unit or bus."""
    numbers = [number for (number,) in connection.execute(_LAST_OF_EACH, (kind, before))]
    found = (queries.one(connection, number) for number in numbers)
    return [event for event in found if event is not None]


def first_gap(connection: StoreConnection, shift: Shift) -> tuple[UnixTime, UnixTime] | None:
    """From the last record before a start of the server up to that start, where it reaches into a shift."""
    start = connection.execute(_NEXT_START, (shift.start,)).fetchone()
    if start is None:
        return None
    query = "SELECT max(time) AS time FROM events WHERE about IS NULL AND time < ?"
    last = connection.execute(query, (start["time"] - STARTING_S,)).fetchone()["time"]
    return None if last is None or last >= shift.end else (UnixTime(last), UnixTime(start["time"]))


def first_event_at(connection: StoreConnection) -> UnixTime | None:
    """When the log begins."""
    row = connection.execute("SELECT time FROM events ORDER BY id LIMIT 1").fetchone()
    return None if row is None else UnixTime(row["time"])
