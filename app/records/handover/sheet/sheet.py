"""The sheet of a shift, made from the store. What the store does not hold is an omission, never a guess."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NotRequired
from zoneinfo import ZoneInfo

from pydantic import Field
from typing_extensions import TypedDict

from app.core.database import StoreConnection
from app.core.web.api.shape import Instant, MessageShown, iso, message_shown
from app.line.alarms.rules.state_machine import AlarmState
from app.people.audit.api import EventShown
from app.records.handover.notes.notes import Note, notes_of
from app.records.handover.rules.scope import EVERYTHING, Scope
from app.records.handover.rules.shift_times import Shift, site_time
from app.records.handover.sheet.record import (
    AlarmThen,
    ShiftAlarm,
    ShiftEvents,
    ShiftEventsShown,
    alarm_json,
    alarms_at,
    event_json,
    first_event_at,
    first_gap,
    last_events,
)
from app.records.handover.signing.signatures import MissingSignature, ShiftSignature, SignedSheet
from app.settings import Settings
from bus.instants import UnixTime
from bus.messages import Message

SECTIONS: dict[str, tuple[str, ...]] = {
    "limits": ("limits",),
    "recipes": ("recipe",),
    "control": ("control",),
    "done": ("command", "restore", "parameter_set", "swap", "block", "alarm"),
    "server": ("server", "configuration", "clock", "worker"),
}
"""The kinds of event in each."""
HIDDEN: tuple[AlarmState, ...] = ("shelved", "suppressed", "out_of_service")
DRIFT = "parameter_drift"


class ShiftNote(TypedDict):
    """One note. It is never changed."""

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
    """What the next shift has to know, up to ``until``."""

    start: Instant
    end: Instant
    until: Annotated[Instant, Field(description="End of the shift, or before it when the sheet was made.")]
    made_at: Instant
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
    server: Annotated[ShiftEventsShown, Field(description="Server, configuration, clocks and bus workers.")]
    notes: list[ShiftNote]
    omissions: Annotated[list[MessageShown], Field(description="What the store does not hold of the shift.")]


class ShiftSignatures(TypedDict):
    """What was signed."""

    digest: Annotated[str, Field(description="SHA-256 of the sheet as JSON, hexadecimal.")]
    page_digest: Annotated[str, Field(description="SHA-256 of its page, hexadecimal.")]
    altered: Annotated[bool, Field(description="The stored sheet is not the one that the audit log names.")]
    leaving: ShiftSignature | None
    coming: ShiftSignature | None


class SignaturesOfSheet(TypedDict):
    """What a sheet has beside what is signed."""

    signed: ShiftSignatures | None
    missing_signatures: Annotated[
        list[MissingSignature],
        Field(description="Those that the audit log names and the store has lost; mostly none."),
    ]
    later_notes: Annotated[
        list[ShiftNote], Field(description="Those written since it was signed; not part of it.")
    ]


class ShiftSheet(SignedShiftSheet, SignaturesOfSheet):
    """The sheet, as it was signed where it is."""


def write_sheet(
    connection: StoreConnection,
    settings: Settings,
    shift: Shift,
    now: UnixTime,
    scope: Scope = EVERYTHING,
) -> dict[str, Any]:
    """The sheet of a shift as the store is at one instant; in a transaction. ``scope``: of a line or a unit
    only, with the notes about the site."""
    until = min(shift.end, now)
    seen = Shift(shift.start, until)
    alarms = [each for each in alarms_at(connection, until) if scope.holds(each.bus, each.unit)]
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
        **{name: events.of(kinds) for name, kinds in SECTIONS.items()},
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
    """The signatures as the API has them."""
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
    """Notes as the API has them."""
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
