"""Finds present alarms by what they are called and by the unit that they are of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from app.alarms.alarm import Alarm
from app.alarms.monitor.line_alarms import LineAlarms
from app.find.finders import FoundPlace, Search, matched


class AlarmFinder:
    def __init__(self, alarms: LineAlarms) -> None:
        self._alarms = alarms

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Each alarm that is not normal."""
        return [place for alarm in self._alarms.present() for place in self._of_alarm(search, alarm)]

    def _of_alarm(self, search: Search, alarm: Alarm) -> Iterator[FoundPlace]:
        t, definition = search.language.t, alarm.definition
        place = self._alarms.place(definition.bus, definition.unit)
        name, state = t(definition.name), t(alarm.state_text)
        label = f"{place} · {name}" if place else name
        yield from matched(search, FoundPlace(label, f"/alarms/{alarm.id}", state), name, place, state)
