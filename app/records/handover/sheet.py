"""The sheet of a shift, made from the store: the alarms and blocks at its end, its events, notes, figures.

Data that the store does not hold is named as an omission, never guessed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, NotRequired, cast
from zoneinfo import ZoneInfo

from pydantic import Field
from typing_extensions import TypedDict

from app.core.database import StoreConnection
from app.core.database.connection import json_member
from app.core.web.shape import Instant, MaybeInstant, MessageShown, iso, message_shown
from app.line.alarms.api import AlarmTransition, transition_json
from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules import AlarmState
from app.people.audit import log
from app.people.audit.api import EventShown, shown
from app.people.audit.log import Event, Filter
from app.records.handover.figures import LineFigures
from app.records.handover.notes import Note, notes_of
from app.records.handover.rules import EVERYTHING, Scope, Shift, site_time
from app.records.handover.signatures import MissingSignature, ShiftSignature, SignedSheet
from app.settings import Settings
from bus.instants import UnixTime
from bus.messages import Message

MAX_EVENTS = 200
"""The most events of one kind on a sheet, the newest; the events page has all."""
STARTING_S = 60.0
"""The seconds before a start of the server in which an event belongs to that start."""
_OUTCOME = "COALESCE(f.outcome, e.outcome, '')"
_ENTRY = ", ".join(f"j.{field.name}" for field in fields(JournalEntry))
_LAST_TRANSITIONS = f"""
SELECT {_ENTRY}, (
    SELECT r.at FROM alarm_journal r WHERE r.alarm = j.alarm AND r.id <= j.id AND r.trigger = 'rise'
    ORDER BY r.id DESC LIMIT 1
) AS came FROM alarm_facts known JOIN alarm_journal j ON j.id = (
    SELECT id FROM alarm_journal WHERE alarm = known.alarm AND at < ? ORDER BY id DESC LIMIT 1
) WHERE j.after <> 'normal'
ORDER BY j.after NOT IN ('unack_active', 'ack_active'), COALESCE(came, j.at), j.id
"""
_EARLIER = f"""
SELECT {_ENTRY}, (
    SELECT r.at FROM alarm_journal r WHERE r.alarm = first.alarm AND r.id <= first.id AND r.trigger = 'rise'
    ORDER BY r.id DESC LIMIT 1
) AS came FROM alarm_facts known JOIN alarm_journal first ON first.id = (
    SELECT id FROM alarm_journal WHERE alarm = known.alarm AND at < :start ORDER BY id DESC LIMIT 1
) JOIN alarm_journal j ON j.id = (
    SELECT id FROM alarm_journal WHERE alarm = known.alarm AND at < :until ORDER BY id DESC LIMIT 1
) WHERE first.after <> 'normal'
ORDER BY j.after NOT IN ('unack_active', 'ack_active'), COALESCE(came, first.at), first.id
"""
_HIDDEN_BY = """
SELECT who, reason FROM alarm_journal
WHERE alarm = ? AND id <= ? AND trigger IN ('shelve', 'suppress', 'remove') ORDER BY id DESC LIMIT 1
"""
_SHELVED_UNTIL = "SELECT shelved_until FROM alarm_facts WHERE alarm = ?"
_LAST_OF_EACH = """
SELECT max(id) FROM events WHERE about IS NULL AND kind = ? AND time < ? GROUP BY bus, unit ORDER BY 1
"""
_SERVER = f"about IS NULL AND kind = 'server' AND {json_member('messages', 'what.code')}"
_STARTS = f"SELECT time FROM events WHERE {_SERVER} = 'event_server_started' AND time >= ? ORDER BY id"
_LAST_BEFORE = f"""
SELECT time FROM events WHERE about IS NULL AND time < :start
AND (time < :start - {STARTING_S} OR {_SERVER} = 'event_server_ended')
ORDER BY time DESC LIMIT 1
"""
_EXTENT = "SELECT min(id), max(id) FROM events WHERE about IS NULL AND time >= ? AND time < ?"
_COUNTS = f"""
SELECT e.kind, {_OUTCOME}, count(*) FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL AND e.id BETWEEN ? AND ? AND e.time >= ? AND e.time < ?
AND e.id NOT IN (SELECT event FROM event_parts)
"""


class ShiftEventsShown(TypedDict):
    """The events of the shift: at most the newest 200, oldest first."""

    total: Annotated[int, Field(description="How many there were in all.")]
    outcomes: Annotated[dict[str, int], Field(description="How many had each outcome; empty: had none.")]
    events: list[EventShown]


class ShiftEvents:
    """The events of one shift, read in one transaction."""

    def __init__(self, connection: StoreConnection, shift: Shift, scope: Scope = EVERYTHING) -> None:
        self._connection = connection
        self._shift = shift
        self._scope = scope
        self._first, self._last = connection.execute(_EXTENT, (shift.start, shift.end)).fetchone()
        self._counted = self._count()

    def shown(self, kinds: Sequence[str]) -> ShiftEventsShown:
        """Return the events of some kinds. A change of several units is one event."""
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
        return log.select(self._connection, wanted, MAX_EVENTS)

    def _count(self) -> dict[str, Counter[str]]:
        where, values = self._scope.conditions("e.")
        bounds = (self._first or 0, self._last or 0, self._shift.start, self._shift.end, *values)
        counted: dict[str, Counter[str]] = {}
        for kind, outcome, times in self._connection.execute(f"{_COUNTS}{where} GROUP BY 1, 2", bounds):
            counted.setdefault(kind, Counter())[outcome] = times
        return counted


def event_json(event: Event) -> EventShown:
    """Return an event as JSON of the API without its frames, which the events have."""
    return cast(EventShown, shown({**event, "frames": "[]"}))


@dataclass(frozen=True, slots=True)
class AlarmThen(JournalEntry):
    """The last transition of an alarm before a moment, and the time when the alarm came (None: never)."""

    came: UnixTime | None = None
    shelved_until: UnixTime | None = None


class ShiftAlarm(AlarmTransition):
    """An alarm in its state at the end, by its last transition."""

    came: NotRequired[
        Annotated[
            MaybeInstant,
            Field(description="When it came; absent from sheets that an earlier version signed."),
        ]
    ]
    shelved_until: NotRequired[
        Annotated[Instant, Field(description="Of a shelved alarm, in the sheet of the shift under way.")]
    ]


def alarm_json(alarm: AlarmThen) -> ShiftAlarm:
    shown = cast(
        ShiftAlarm, {**transition_json(alarm), "came": None if alarm.came is None else iso(alarm.came)}
    )
    if alarm.shelved_until is not None:
        shown["shelved_until"] = iso(alarm.shelved_until)
    return shown


def alarms_at(connection: StoreConnection, at: UnixTime) -> list[AlarmThen]:
    """Return the last transition before a moment of each alarm that was not normal then, active first. What
    hides an alarm has its person and reason."""
    found = (AlarmThen(*row) for row in connection.execute(_LAST_TRANSITIONS, (at,)))
    return [_with_reason(connection, each) for each in found]


def alarms_before(connection: StoreConnection, start: UnixTime, until: UnixTime) -> list[AlarmThen]:
    """Return the last transition before ``until`` of each alarm that was not normal at ``start``, with the
    time when it had come by then."""
    rows = connection.execute(_EARLIER, {"start": start, "until": until})
    return [_with_reason(connection, AlarmThen(*row)) for row in rows]


def _with_reason(connection: StoreConnection, alarm: AlarmThen) -> AlarmThen:
    if alarm.after not in HIDDEN:
        return alarm
    hidden = connection.execute(_HIDDEN_BY, (alarm.alarm, alarm.id)).fetchone()
    return alarm if hidden is None else replace(alarm, who=hidden["who"], reason=hidden["reason"])


def _with_end(connection: StoreConnection, alarm: AlarmThen) -> AlarmThen:
    if alarm.after != "shelved":
        return alarm
    (until,) = connection.execute(_SHELVED_UNTIL, (alarm.alarm,)).fetchone()
    return replace(alarm, shelved_until=until)


def last_events(connection: StoreConnection, kind: str, before: UnixTime) -> list[Event]:
    """Return the last event of a kind before a moment, for each unit or bus."""
    numbers = [number for (number,) in connection.execute(_LAST_OF_EACH, (kind, before))]
    found = (log.one(connection, number) for number in numbers)
    return [event for event in found if event is not None]


def first_gap(connection: StoreConnection, shift: Shift) -> tuple[UnixTime, UnixTime] | None:
    """Return the time from the last record before a start of the server to that start, if it reaches into a
    shift and is longer than a start takes."""
    for (start,) in connection.execute(_STARTS, (shift.start,)):
        row = connection.execute(_LAST_BEFORE, {"start": start}).fetchone()
        if row is None or row["time"] >= shift.end:
            return None
        if start - row["time"] > STARTING_S:
            return UnixTime(row["time"]), UnixTime(start)
    return None


def first_event_at(connection: StoreConnection) -> UnixTime | None:
    """Return the time at which the log begins."""
    row = connection.execute("SELECT time FROM events ORDER BY id LIMIT 1").fetchone()
    return None if row is None else UnixTime(row["time"])


SECTIONS: dict[str, tuple[str, ...]] = {
    "limits": ("limits",),
    "recipes": ("recipe",),
    "control": ("control",),
    "done": ("command", "restore", "parameter_set", "swap", "block", "alarm"),
    "server": ("server", "configuration", "clock", "worker", "bus"),
}
"""The kinds of events in each section."""
HIDDEN: tuple[AlarmState, ...] = ("shelved", "suppressed", "out_of_service")
DRIFT = "parameter_drift"


class ShiftNote(TypedDict):
    """A note. It never changes."""

    id: int
    time: Annotated[Instant, Field(description="What it is about. ISO 8601, UTC.")]
    written_at: Annotated[Instant, Field(description="By the clock of the server.")]
    who: str
    text: str
    bus: str | None
    unit: Annotated[int | None, Field(description="Address of the unit (#17), 1 to 255.")]
    alarm: Annotated[str | None, Field(description="The id of an occurrence.")]
    corrects: Annotated[int | None, Field(description="The note in whose place it is.")]
    corrected_by: Annotated[int | None, Field(description="The note that is in its place.")]
    pictures: Annotated[list[str], Field(description="The SHA-256 of each, by which it is loaded.")]


class SignedShiftSheet(TypedDict):
    """The sheet for the next shift, up to ``until``."""

    start: Instant
    end: Instant
    until: Annotated[Instant, Field(description="End of the shift, or before it when the sheet was made.")]
    made_at: Instant
    line: NotRequired[
        Annotated[
            LineFigures,
            Field(
                description="What the line did; absent from sheets that an earlier version signed, and "
                "where the history cannot be read."
            ),
        ]
    ]
    site: str
    time_zone: Annotated[str, Field(description="IANA name.")]
    standing: Annotated[
        list[ShiftAlarm],
        Field(description="Alarms that were not normal, each with its last transition; nothing hides them."),
    ]
    shelved: list[ShiftAlarm]
    suppressed: NotRequired[
        Annotated[
            list[ShiftAlarm],
            Field(description="Suppressed by design; absent from sheets that an earlier version signed."),
        ]
    ]
    out_of_service: list[ShiftAlarm]
    drift: Annotated[list[ShiftAlarm], Field(description="Differences from the golden sets.")]
    blocked: Annotated[list[EventShown], Field(description="Units closed to commands, as they were blocked.")]
    limits: ShiftEventsShown
    recipes: ShiftEventsShown
    control: ShiftEventsShown
    control_before: Annotated[
        list[EventShown], Field(description="The last event of each bus about control before the shift.")
    ]
    done: Annotated[ShiftEventsShown, Field(description="Commands, restores, sets, blocks, acts on alarms.")]
    server: Annotated[ShiftEventsShown, Field(description="Server, configuration, clocks, workers, ports.")]
    notes: list[ShiftNote]
    omissions: Annotated[list[MessageShown], Field(description="What the store does not hold of the shift.")]


class ShiftSignatures(TypedDict):
    """The signatures of a sheet."""

    digest: Annotated[str, Field(description="SHA-256 of the sheet as JSON, hexadecimal.")]
    page_digest: Annotated[str, Field(description="SHA-256 of its page, hexadecimal.")]
    altered: Annotated[bool, Field(description="The stored sheet is not the one that the audit log names.")]
    leaving: ShiftSignature | None
    coming: ShiftSignature | None


class SignaturesOfSheet(TypedDict):
    """The parts of a sheet that are not signed."""

    signed: ShiftSignatures | None
    missing_signatures: Annotated[
        list[MissingSignature],
        Field(description="Those that the audit log names and the store has lost; mostly none."),
    ]
    later_notes: Annotated[
        list[ShiftNote], Field(description="Those written since it was signed; not part of it.")
    ]


class ShiftSheet(SignedShiftSheet, SignaturesOfSheet):
    """The sheet of a shift, as signed if it is signed."""


def write_sheet(
    connection: StoreConnection,
    settings: Settings,
    shift: Shift,
    now: UnixTime,
    scope: Scope = EVERYTHING,
) -> dict[str, Any]:
    """Return the sheet of a shift as the store is at one instant, in a transaction. ``scope``: a line or a
    unit to which the sheet is limited, with the notes about the site."""
    until = min(shift.end, now)
    seen = Shift(shift.start, until)
    alarms = [each for each in alarms_at(connection, until) if scope.holds(each.bus, each.unit)]
    if until == now:
        alarms = [_with_end(connection, each) for each in alarms]
    events = ShiftEvents(connection, seen, scope)
    last = last_events(connection, "block", until)
    blocked = [each for each in last if each["new"] is not None and scope.holds(each["bus"], each["unit"])]
    control = last_events(connection, "control", shift.start)
    before = [each for each in control if scope.concerns(each["bus"], None)]
    notes = [each for each in notes_of(connection, shift) if scope.concerns(each.bus, each.unit)]
    return {
        "start": iso(shift.start),
        "end": iso(shift.end),
        "until": iso(until),
        "made_at": iso(now),
        "site": settings.site.name,
        "time_zone": settings.site.zone,
        "standing": [alarm_json(entry) for entry in alarms if entry.after not in HIDDEN],
        **{state: [alarm_json(entry) for entry in alarms if entry.after == state] for state in HIDDEN},
        "drift": [alarm_json(entry) for entry in alarms if entry.code == DRIFT],
        "blocked": [event_json(each) for each in blocked],
        **{name: events.shown(kinds) for name, kinds in SECTIONS.items()},
        "control_before": [event_json(each) for each in before],
        "notes": notes_json(notes),
        "omissions": [*map(message_shown, _omissions(connection, settings, seen, alarms))],
    }


def _omissions(
    connection: StoreConnection, settings: Settings, shift: Shift, alarms: Sequence[AlarmThen]
) -> Iterator[Message]:
    begins = first_event_at(connection)
    if begins is None or begins > shift.start:
        yield Message("shift_omits_before_record")
    gap = first_gap(connection, shift)
    if gap is not None:
        last, start = (site_time(each, ZoneInfo(settings.site.zone)) for each in gap)
        yield Message.of("shift_omits_downtime", last=last, start=start)
    if alarms:
        yield Message("shift_omits_quality")
    (golden,) = connection.execute("SELECT count(*) FROM golden_set").fetchone()
    units = sum(len(bus.unit) for bus in settings.bus)
    if golden < units:
        yield Message.of("shift_omits_drift", golden=golden, units=units)
    yield Message("shift_omits_lapse" if settings.site.control else "shift_omits_control")


def signed_json(signed: SignedSheet | None) -> ShiftSignatures | None:
    """Return the signatures in the form of the API."""
    if signed is None:
        return None
    return {
        "digest": signed.digest,
        "page_digest": signed.page_digest,
        "altered": signed.is_altered,
        "leaving": signed.signatures.get("leaving"),
        "coming": signed.signatures.get("coming"),
    }


def notes_json(notes: Sequence[Note]) -> list[ShiftNote]:
    """Return notes in the form of the API."""
    corrected_by = {note.corrects: note.id for note in notes}
    return [
        {
            "id": note.id,
            "time": iso(note.at),
            "written_at": iso(note.written_at),
            "who": note.who,
            "text": note.text,
            "bus": note.bus,
            "unit": note.unit,
            "alarm": note.alarm,
            "corrects": note.corrects,
            "corrected_by": corrected_by.get(note.id),
            "pictures": note.pictures.split(),
        }
        for note in notes
    ]
