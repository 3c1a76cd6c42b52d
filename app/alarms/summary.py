"""The list of alarms as a page shows it: filtered, and in an order in which no row moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlencode

from app.alarms.alarm import Alarm
from app.alarms.group import group_of
from app.alarms.line_alarms import LineAlarms
from app.alarms.shown import present_value
from bus.instants import UnixTime
from bus.messages import Message

MAX_ROWS = 100
"""In the summary: as many as are acknowledged together at most."""


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One alarm as a page shows it."""

    key: str
    id: str
    name: str | Message
    bus: str | None
    unit: int | None
    place: str
    priority: str
    mark: str
    code_of_state: str
    state: Message
    waiting: bool
    sounds: bool
    silenced: bool
    since: UnixTime | None
    came: UnixTime | None
    cleared: UnixTime | None
    acknowledged_at: UnixTime | None
    unknown_since: UnixTime | None
    shelved_until: UnixTime | None
    value: Message | None
    first_out: bool
    hidden_by: str
    reason: str


def listed(alarms: LineAlarms, chosen: dict[str, str], shown: Sequence[str] = ()) -> dict[str, Any]:
    """What the list of alarms shows. ``shown``: the keys of the rows that a person sees. These stay in their
    places, also where they match no longer, and new alarms come after them."""
    kept = dict.fromkeys(alarm for key in shown if (alarm := alarms.known(key)) is not None)
    new = [alarm for alarm in alarms.present() if alarm not in kept and _matches(alarm, chosen)]
    found = [*kept, *new]
    rows = [row_of(alarms, alarm) for alarm in found[:MAX_ROWS]]
    return {
        "rows": rows,
        "waiting": [row.id for row in rows if row.waiting],
        "more": max(0, len(found) - MAX_ROWS),
        "query": query_of(chosen),
        "is_filtered": any(chosen.values()),
    }


def query_of(chosen: dict[str, str]) -> str:
    """What a person filters by, as the query of a link."""
    return urlencode({name: value for name, value in chosen.items() if value})


def _matches(alarm: Alarm, chosen: dict[str, str]) -> bool:
    definition = alarm.definition
    bus, _, unit = chosen["place"].partition("/")
    filters: tuple[tuple[str, Callable[[], object]], ...] = (
        (chosen["state"], lambda: alarm.facts.state),
        (chosen["priority"], lambda: definition.priority),
        (chosen["group"], lambda: group_of(definition)),
        (bus, lambda: definition.bus),
        (unit, lambda: str(definition.unit)),
    )
    return all(not wanted or wanted == value() for wanted, value in filters)


def places_of(alarms: LineAlarms) -> list[tuple[str, str]]:
    """Each bus and each of its units."""
    places: list[tuple[str, str]] = []
    for name, bus in alarms.buses.items():
        places.append((name, name))
        places += [(f"{name}/{unit}", f"{name} · {text}") for unit, text in bus.unit_names().items()]
    return places


def row_of(alarms: LineAlarms, alarm: Alarm) -> AlarmRow:
    """An alarm as it is now."""
    definition, facts = alarm.definition, alarm.facts
    by_person = facts.state in ("shelved", "out_of_service")
    return AlarmRow(
        key=definition.key,
        id=alarm.id,
        name=definition.name,
        bus=definition.bus,
        unit=definition.unit,
        place=alarms.place(definition.bus, definition.unit),
        priority=definition.priority,
        mark=alarm.mark,
        code_of_state=facts.state,
        state=state_text(facts.state),
        waiting=alarm.is_unacknowledged,
        sounds=facts.sounds,
        silenced=facts.silenced,
        since=facts.since,
        came=facts.came,
        cleared=facts.cleared,
        acknowledged_at=facts.acknowledged_at,
        unknown_since=facts.unknown_since,
        shelved_until=facts.shelved_until,
        value=present_value(alarms, alarm),
        first_out=alarm.first_out,
        hidden_by=alarm.hidden_by if by_person else "",
        reason=alarm.reason if by_person else "",
    )


def state_text(state: str) -> Message:
    """The words for a state."""
    return Message(f"alarm_state_{state}")
