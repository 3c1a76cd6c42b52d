"""The last event of each line, as the event log has it."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass, field

from app.audit.entry import EventKind
from app.audit.log import Event, EventLog
from app.audit.queries import Filter
from app.errors import StoreError
from app.live.state.bus_live import LiveState
from app.sites.summary import EventSummary
from bus.messages import Message, ParamValue, term

READ_EVERY_S = 1.0
MAX_READ = 10
"""Events of a line that are read: the last of a shown kind is nearly always among them."""
SHOWN: frozenset[EventKind] = frozenset(
    ("block", "bus", "command", "estop", "mode", "recipe", "restore", "run", "swap", "unit", "worker")
)
"""The kinds that explain what a line does; control, sign-ins and notes do not."""
LATE = "event_readings_late"
"""At each start of the server: its worker begins before it."""
DONE = ("verified", "acknowledged")


@dataclass(eq=False, repr=False)
class LastEvents:
    """Reads the event log where a line has a new event."""

    live: LiveState
    events: EventLog
    _last: dict[str, EventSummary] = field(default_factory=dict)
    _changed: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._changed |= set(self.live.buses)
        self.events.subscribe(self._note)

    def of(self, bus: str) -> EventSummary | None:
        """None where there is none yet."""
        return self._last.get(bus)

    def _note(self, event: Event) -> None:
        if event["bus"] in self.live.buses:
            self._changed.add(event["bus"])

    async def follow(self) -> None:
        """Run until canceled: read what was logged. While the log cannot be read, the known ones stay."""
        while True:
            await self.read()
            await asyncio.sleep(READ_EVERY_S)

    async def read(self) -> None:
        """Read the last event of each line that has a new one. A change of several units is one."""
        for bus in sorted(self._changed):
            with suppress(StoreError):
                found, _ = await self.events.page(Filter(bus=bus, folded=True), MAX_READ)
                self._changed.discard(bus)
                last = next((event for event in found if _is_shown(event)), None)
                if last is not None and last["time"]:
                    self._last[bus] = EventSummary(float(last["time"]), self._text(last))

    def _text(self, event: Event) -> Message:
        """``Dryer 2 · speed set: 120.0 → 121.0``, with the result where the command was not carried out."""
        unit = self.live.buses[event["bus"]].units.get(event["unit"] or 0)
        old, new = _field(event, "old"), _field(event, "new")
        if old and new:
            text = Message.of("line_event_change", what=_field(event, "what"), old=old, new=new)
        else:
            text = Message.of("line_event", what=_field(event, "what"))
        if event["outcome"] not in (None, *DONE):
            text = Message.of("line_event_outcome", event=text, outcome=term(event["outcome"]))
        if unit is None:
            return text
        return Message.of("line_event_at", name=unit.settings.name, event=text)


def _is_shown(event: Event) -> bool:
    what = _field(event, "what")
    return event["kind"] in SHOWN and not (isinstance(what, Message) and what.code == LATE)


def _field(event: Event, name: str) -> ParamValue:
    found: ParamValue = event["messages"].get(name) or event[name] or ""
    return found
