"""Selects the changes of a line that become events. Pure: updates in, changes out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from app.line.conditions.condition import Condition
from app.line.conditions.of_bus import PORT_LOST
from app.line.conditions.of_unit import BY_READING, UNIT_OFFLINE
from app.line.live.state.conditions import status_conditions
from app.people.audit.entry import EventKind
from bus.catalogue.status import status_bits
from bus.contract import BusFigures, BusLink, BusLinkState, Reading, UnitLink, UnitLinkState, Update
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import BusSettings

PORT_REMARKS = frozenset(("diagnosis_port_changed", "diagnosis_port_changed_by", "diagnosis_port_shared"))
"""Of a diagnosis, which become events."""


@dataclass(frozen=True, slots=True)
class LineEvent:
    """An event to be recorded. ``unit`` None: the bus."""

    kind: EventKind
    unit: int | None
    at: UnixTime
    what: Message
    old: Message | str
    new: Message | str
    message: Message | None = None
    series: str = ""
    """Separates series of one unit and kind, where one must not crowd out the other."""
    count: int = 0
    """How many it stands for, of what is summed up from the first on: it becomes `new`."""


@dataclass(slots=True)
class Changes:
    """The last state of one bus. The first state seen is no change."""

    settings: BusSettings
    _port: BusLinkState | None = None
    _conditions: dict[int, frozenset[str]] = field(default_factory=dict)
    _links: dict[int, UnitLinkState] = field(default_factory=dict)
    _remarks: list[Message] = field(default_factory=list)

    def see(self, update: Update) -> list[LineEvent]:
        """What this update changes, compared with the one before."""
        match update:
            case Reading():
                return self._see_reading(update)
            case UnitLink():
                return self._see_unit_link(update)
            case BusLink():
                return self._see_port(update)
            case BusFigures():
                return self._see_remarks(update)
        return []

    def _see_reading(self, reading: Reading) -> list[LineEvent]:
        before = self._conditions.get(reading.unit)
        now = status_conditions(status_bits(reading.outputs, reading.inputs, self.settings.estop_healthy))
        self._conditions[reading.unit] = now
        if before is None or before == now:
            return []
        changed = [row for row in BY_READING if row.event and (row.code in before) != (row.code in now)]
        return [_event(row, reading.unit, reading.at, row.code in now) for row in changed]

    def _see_unit_link(self, update: UnitLink) -> list[LineEvent]:
        before = self._links.get(update.unit, "unknown")
        if update.link not in ("online", "offline") or update.link == before:
            return []
        if update.link == "offline" and self._port == "closed":
            return []
        self._links[update.unit] = update.link
        if before == "unknown":
            return []
        return [_event(UNIT_OFFLINE, update.unit, update.at, update.link == "offline", update.cause)]

    def _see_remarks(self, figures: BusFigures) -> list[LineEvent]:
        """That another program uses the port or changed its settings."""
        before = self._remarks
        self._remarks = [each for each in figures.diagnosis if each.code in PORT_REMARKS]
        new = [each for each in self._remarks if each not in before]
        return [LineEvent("bus", None, figures.at, each, "", "", series=each.code) for each in new]

    def _see_port(self, update: BusLink) -> list[LineEvent]:
        before, self._port = self._port, update.link
        if before is None or before == update.link:
            return []
        return [_event(PORT_LOST, None, update.at, update.link == "closed", update.cause)]


def _event(
    row: Condition[Any], unit: int | None, at: UnixTime, holds: bool, cause: Message | None = None
) -> LineEvent:
    """That a condition began or ended."""
    event = row.event
    assert event is not None
    code, words = (event.began, (event.off, event.on)) if holds else (event.ended, (event.on, event.off))
    what = Message.of(f"{code}_because", cause=cause) if holds and cause else Message(code)
    return LineEvent(event.kind, unit, at, what, *words)
