"""The alarms in the head of every page and on the tiles, as fields."""

from __future__ import annotations

from app.alarms.alarm import Alarm
from app.alarms.line_alarms import LineAlarms
from app.live.screen.fields import Fields, Translator
from app.live.screen.sources import AlarmChangeSubscriber

MOST = 3
"""Named in the head of a page; the summary has all."""


class AlarmBanner:
    """``changed`` is another text after each change, so that an open summary draws itself again."""

    def __init__(self, alarms: LineAlarms) -> None:
        self._alarms = alarms
        self._changed = 0
        alarms.subscribe(self._note)

    def _note(self, _: Alarm) -> None:
        self._changed += 1

    def on_change(self, subscriber: AlarmChangeSubscriber) -> None:
        """Call ``subscriber`` with the place of each alarm that has changed."""
        self._alarms.subscribe(lambda alarm: subscriber(alarm.definition.bus, alarm.definition.unit))

    def banner(self, translator: Translator) -> Fields:
        """How many wait for an acknowledgement, and the first three of them."""
        waiting, shown = self._alarms.first_waiting(MOST)
        fields = {"waiting": str(waiting or ""), "changed": str(self._changed), **self._sound()}
        for place in range(MOST):
            alarm = shown[place] if place < len(shown) else None
            fields[f"priority{place + 1}"] = alarm.definition.priority if alarm else ""
            fields[f"text{place + 1}"] = self.text(alarm, translator) if alarm else ""
        return fields

    def _sound(self) -> Fields:
        """The priority that sounds, and when the newest of those that do began to."""
        sounding = self._alarms.sounding()
        if not sounding:
            return {"sound": "", "sound_at": ""}
        at = max(float(alarm.facts.since or 0.0) for alarm in sounding)
        return {"sound": sounding[0].definition.priority, "sound_at": repr(at)}

    def mark(self, bus: str, unit: int) -> str:
        """``urgent``, or ``urgent waiting`` while it is not acknowledged."""
        first = next(iter(self._alarms.annunciated(bus, unit)), None)
        if first is None:
            return ""
        return first.definition.priority + (" waiting" if first.is_unacknowledged else "")

    def text(self, alarm: Alarm, translator: Translator) -> str:
        """Where and what."""
        definition = alarm.definition
        place = self._alarms.place(definition.bus, definition.unit)
        return f"{place} · {translator.t(definition.name)}".removeprefix(" · ")
