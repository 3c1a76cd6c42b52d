"""The list of alarms as a page shows it: filtered, and in an order in which no row moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple
from urllib.parse import urlencode

from app.alarms.alarm import Alarm
from app.alarms.monitor.line_alarms import LineAlarms, rank
from app.alarms.shown import present_value
from bus.instants import UnixTime
from bus.messages import Message

MAX_ROWS = 100
"""In the summary: as many as are acknowledged together at most."""


class AlarmRow(NamedTuple):
    """An alarm as a page shows it: with where it is, the present value of what it is about, and whether it
    came three times within a minute."""

    alarm: Alarm
    place: str
    value: Message | None
    chatters: bool


def listed(
    alarms: LineAlarms, chosen: dict[str, str], now: UnixTime, shown: Sequence[str] = ()
) -> dict[str, Any]:
    """What the list of alarms shows. ``shown``: the keys of the rows that a person sees. These stay in their
    places, also where they match no longer, and new alarms come after them."""
    known = (alarms.known(key) for key in shown)
    kept = dict.fromkeys(alarm for alarm in known if alarm is not None)
    new = [alarm for alarm in alarms.present() if alarm not in kept and _matches(alarm, chosen)]
    found = [*kept, *new]
    rows = [row_of(alarms, alarm, now) for alarm in found[:MAX_ROWS]]
    return {
        "rows": rows,
        "waiting": [row.alarm.id for row in rows if row.alarm.is_unacknowledged],
        "more": max(0, len(found) - MAX_ROWS),
        "query": query_of(chosen),
        "is_filtered": any(chosen.values()),
        "is_sorted": found == sorted(found, key=rank),
        "flood": alarms.rates.flood(now),
    }


def query_of(chosen: dict[str, str]) -> str:
    """What a person filters by, as the query of a link."""
    return urlencode({name: value for name, value in chosen.items() if value})


def _matches(alarm: Alarm, chosen: dict[str, str]) -> bool:
    definition = alarm.definition
    bus, _, unit = chosen["place"].partition("/")
    return (
        chosen["state"] in ("", alarm.facts.state)
        and chosen["priority"] in ("", definition.priority)
        and chosen["group"] in ("", definition.about)
        and bus in ("", definition.bus)
        and unit in ("", str(definition.unit))
    )


def places_of(alarms: LineAlarms) -> list[tuple[str, str]]:
    """Return each bus and each of its units, as filters with their names."""
    places: list[tuple[str, str]] = []
    for name, bus in alarms.buses.items():
        places.append((name, name))
        places += [(f"{name}/{unit}", f"{name} · {text}") for unit, text in bus.unit_names().items()]
    return places


def row_of(alarms: LineAlarms, alarm: Alarm, now: UnixTime) -> AlarmRow:
    """An alarm as it is now."""
    definition = alarm.definition
    place = alarms.place(definition.bus, definition.unit)
    chatters = alarms.rates.chatters(definition.key, now)
    return AlarmRow(alarm, place, present_value(alarms, alarm), chatters)
