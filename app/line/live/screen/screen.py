"""The line on the browsers' pages in one language: the fields, and which of them changed.

Between the live state and the sockets: no I/O and no clock. Order of use: :meth:`Screen.see` for what
a worker reported, :meth:`Screen.settle` once a second for what only time changes; both give the
fields that are different now.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from app.line.live.diagnosis.abnormal import UnitView, shown_cause
from app.line.live.diagnosis.cause import broken_rung, unit_cause
from app.line.live.screen.cause_text import cause_texts, check_text, joined
from app.line.live.screen.diff import FlatFields, Groups, merge_groups, put_fields
from app.line.live.screen.fields import Fields, Translator, bus_fields, draw_fields, unit_fields, unit_key
from app.line.live.screen.sources import Sources
from app.line.live.screen.totals import AbnormalItem, abnormal_of, entries_of, line_fields
from app.line.live.state.age import unit_link_now
from app.line.live.state.bus_live import BusLive, LiveState, UnitLive
from app.line.live.state.draw import draw_of
from bus.instants import UnixTime
from bus.messages import Message, listed

LINE_GROUP = "line_summary"
"""The group of the totals: a name that no bus can have (a slug holds no underscore)."""
ALARM_GROUP = "alarms_present"
_DECIDES = {"link", "state", "level", "cause"}
"""A change of these in a unit may change the strip and the totals of the line."""
MAX_DEPARTED = 3
"""Named one by one; more are a number, and the page of recipes has them all."""


@dataclass(slots=True)
class Screen:
    """What the pages in one language show now."""

    live: LiveState
    translator: Translator
    sources: Sources
    shown: Groups = field(default_factory=dict)
    entries: list[AbnormalItem] = field(default_factory=list)
    """The worst of what is abnormal now, and those of the strip."""
    _views: dict[str, UnitView] = field(default_factory=dict)

    def see(self, bus_name: str, units: Iterable[int], now: UnixTime, *, include_bus: bool) -> Groups:
        """Render the units of a report; return the changed fields."""
        bus = self.live.buses[bus_name]
        changed: Groups = {}
        for number in units:
            changed |= self.put(unit_key(bus_name, number), self._unit(bus_name, bus, bus.units[number], now))
        if include_bus:
            recipe = {"recipe": self._recipe(bus_name)}
            changed |= self.put(bus_name, bus_fields(bus, self.translator, now) | recipe)
        if include_bus or not all(_DECIDES.isdisjoint(fields) for fields in changed.values()):
            changed |= self.put(LINE_GROUP, self._line(now))
        return changed

    def settle(self, now: UnixTime) -> Groups:
        """Render everything whose quality has changed by time alone."""
        changed: Groups = {}
        for name, bus in self.live.buses.items():
            aged = []
            for number, unit in bus.units.items():
                link = unit_link_now(bus, unit, now)
                if link == "stale" or self.shown.get(unit_key(name, number), {}).get("link") != link:
                    aged.append(number)
            merge_groups(changed, self.see(name, aged, now, include_bus=True))
        return changed

    def refresh(self, now: UnixTime) -> Groups:
        """Render everything; a server without a bus has its totals too."""
        buses = self.live.buses.items()
        if not buses:
            return self.put(LINE_GROUP, self._line(now))
        return merge_groups({}, *(self.see(name, bus.units, now, include_bus=True) for name, bus in buses))

    def put(self, group: str, fields: Fields) -> Groups:
        """Set fields that belong to no unit and no bus; return those that changed."""
        return put_fields(self.shown, group, fields)

    def flat(self) -> FlatFields:
        """Everything shown, by ``group.field``, for the first paint of a page."""
        return FlatFields(self.shown)

    def _unit(self, bus_name: str, bus: BusLive, unit: UnitLive, now: UnixTime) -> Fields:
        number = unit.settings.id
        block = self.sources.guards[bus_name].block_reason(number)
        blocked = self.translator.t(block) if block is not None else ""
        drifted = self.sources.drift[bus_name].summary(number, self.translator, now)
        ladder = unit_cause(bus, unit, now)
        cause = shown_cause(bus, unit, ladder, now, blocked=block, drifted=drifted.words)
        view = UnitView(unit, unit_link_now(bus, unit, now), cause, blocked)
        self._views[unit_key(bus_name, number)] = view
        fields = unit_fields(bus, unit, view.link, self.translator)
        line = cause_texts(cause, self.translator, now).line if cause is not None else ""
        fields |= draw_fields(draw_of(bus, unit, now), self.translator)
        return fields | {
            "level": view.level,
            "cause": line if view.level else "",
            "status": line or joined(fields["state_text"]),
            "check": check_text(cause, self.translator),
            "rung": broken_rung(ladder),
            "blocked": blocked,
            "drift": drifted.key,
            **self.sources.alarms.of_unit(bus_name, number, self.translator, now),
        }

    def _recipe(self, bus_name: str) -> str:
        loaded = self.sources.recipes.loaded_words(bus_name)
        if loaded is None:
            return ""
        name, departed = loaded
        if not departed:
            return name
        if len(departed) > MAX_DEPARTED:
            message = Message.of("recipe_with_drift_of_many", name=name, n=len(departed))
        else:
            message = Message.of("recipe_with_drift", name=name, units=listed(departed))
        return self.translator.t(message)

    def _line(self, now: UnixTime) -> Fields:
        buses, views = self.live.buses, self._views
        if len(buses) < len(self.live.buses):
            views = {key: view for key, view in views.items() if key.partition("/")[0] in buses}
        found = abnormal_of(buses, views, now)
        self.entries = entries_of(found, self.translator, now)
        return line_fields(buses, views, found, self.entries, self.translator, now)
