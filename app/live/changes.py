"""Selects the changes of a line that become events. Pure: updates in, changes out."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.audit.kinds import EventKind
from app.live.state.conditions import StatusCondition, status_conditions
from bus.catalogue.status import status_bits
from bus.contract import BusLink, BusLinkState, Reading, UnitLink, UnitLinkState, Update
from bus.instants import UnixTime
from bus.messages import Message, term
from bus.settings import BusSettings


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


_RECORDED: dict[StatusCondition, tuple[EventKind, Message, tuple[Message, Message]]] = {
    "not_in_remote": ("mode", Message("event_mode"), (term("REMOTE"), term("LOCAL"))),
    "estop_active": ("estop", Message("event_estop_input"), (term("healthy"), term("active"))),
    "run_off": ("run", Message("event_run_input"), (term("on"), term("off"))),
}
"""The conditions whose changes are events: kind, what, and the words for not holding and holding."""


@dataclass(slots=True)
class _UnitMemory:
    conditions: frozenset[StatusCondition] | None = None
    link: UnitLinkState = "unknown"


@dataclass(slots=True)
class Changes:
    """The last state of one bus. The first state seen is no change."""

    settings: BusSettings
    _port: BusLinkState | None = None
    _units: dict[int, _UnitMemory] = field(default_factory=dict)

    def see(self, update: Update) -> list[LineEvent]:
        """What this update changes, compared with the one before."""
        match update:
            case Reading():
                return self._see_reading(update)
            case UnitLink():
                return self._see_unit_link(update)
            case BusLink():
                return self._see_port(update)
        return []

    def _memory(self, unit: int) -> _UnitMemory:
        return self._units.setdefault(unit, _UnitMemory())

    def _see_reading(self, reading: Reading) -> list[LineEvent]:
        memory = self._memory(reading.unit)
        before = memory.conditions
        now = status_conditions(status_bits(reading.outputs, reading.inputs, self.settings.estop_healthy))
        memory.conditions = now
        if before is None or before == now:
            return []
        return [
            LineEvent(kind, reading.unit, reading.at, what, words[name in before], words[name in now])
            for name, (kind, what, words) in _RECORDED.items()
            if (name in before) != (name in now)
        ]

    def _see_unit_link(self, update: UnitLink) -> list[LineEvent]:
        memory = self._memory(update.unit)
        before = memory.link
        if update.link not in ("online", "offline") or update.link == before:
            return []
        if update.link == "offline" and self._port == "closed":
            return []
        memory.link = update.link
        if before == "unknown":
            return []
        is_back = update.link == "online"
        what = Message("event_unit_back") if is_back else _because("event_unit_lost", update.cause)
        return [LineEvent("unit", update.unit, update.at, what, term(before), term(update.link))]

    def _see_port(self, update: BusLink) -> list[LineEvent]:
        before, self._port = self._port, update.link
        if before is None or before == update.link:
            return []
        is_open = update.link == "open"
        what = Message("event_port_opened") if is_open else _because("event_port_closed", update.cause)
        return [LineEvent("bus", None, update.at, what, term(before), term(update.link))]


def _because(code: str, cause: Message | None) -> Message:
    return Message.of(f"{code}_because", cause=cause) if cause else Message(code)
