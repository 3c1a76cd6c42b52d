"""The alarms in the head of every page and on the tiles, as fields."""

from __future__ import annotations

from app.line.alarms.alarm import Alarm
from app.line.alarms.monitor.line_alarms import LineAlarms, rank
from app.line.live.screen.fields import Fields, Translator
from app.line.live.screen.sources import AlarmChangeSubscriber
from bus.instants import UnixTime
from bus.messages import Message


class AlarmBanner:
    """``changed`` is another text after each change, so that an open summary draws itself again."""

    def __init__(self, alarms: LineAlarms) -> None:
        self._alarms = alarms
        self._changed = 0
        self._subscribers: list[AlarmChangeSubscriber] = []
        alarms.subscribe(lambda alarm: self._note(alarm.definition.bus, alarm.definition.unit))

    def _note(self, bus: str | None, unit: int | None) -> None:
        self._changed += 1
        for subscriber in self._subscribers:
            subscriber(bus, unit)

    def on_change(self, subscriber: AlarmChangeSubscriber) -> None:
        """Call ``subscriber`` with the place of each alarm that has changed."""
        self._subscribers.append(subscriber)

    def banner(self, translator: Translator, now: UnixTime) -> Fields:
        """The first alarm with its state, and how many more there are: of those that are active or, while
        none is, of those that have cleared. The head has the button to acknowledge it, so one that waits for
        that comes first."""
        found = self._alarms.annunciated()
        shown = [alarm for alarm in found if alarm.facts.active] or found
        first = min(shown, key=lambda alarm: (not alarm.is_unacknowledged, *rank(alarm)), default=None)
        return {
            "mark": first.mark if first else "",
            "place": self._alarms.place(first.definition.bus, first.definition.unit) if first else "",
            "text": translator.t(first.definition.name) if first else "",
            "acknowledge": first.id if first and first.is_unacknowledged else "",
            **_state(first, len(found), translator, now),
            "changed": str(self._changed),
            **self._sound(),
        }

    def _sound(self) -> Fields:
        """The priority that sounds, and when the newest of those that do began to."""
        sounding = self._alarms.sounding()
        if not sounding:
            return {"sound": "", "sound_at": ""}
        at = max(float(alarm.facts.since or 0.0) for alarm in sounding)
        return {"sound": sounding[0].definition.priority, "sound_at": repr(at)}

    def of_unit(self, bus: str, unit: int, translator: Translator, now: UnixTime) -> Fields:
        """The first alarm of a unit, as it is drawn and in words, its page, and how many more there are."""
        found = self._alarms.of_unit(bus, unit)
        first = found[0] if found else None
        fields = _state(first, len(found), translator, now)
        name = translator.t(first.definition.name) if first else ""
        return {"alarm": first.mark if first else "", "alarm_text": name} | {
            f"alarm_{field}": text for field, text in fields.items()
        }


def _state(alarm: Alarm | None, count: int, translator: Translator, now: UnixTime) -> Fields:
    """The state of the first of ``count`` alarms and the time that matters: of a cleared one, when it
    cleared; how many more there are; and the page of the first."""
    if alarm is None:
        return {"state": "", "more": "", "at": ""}
    facts = alarm.facts
    if not facts.active:
        code, at = "alarm_cleared_at", facts.cleared
    elif facts.unknown_since is not None:
        code, at = "alarm_unknown_since", facts.unknown_since
    else:
        code, at = "alarm_active_since", facts.came
    time = translator.formats.since(at or facts.since or now, now)
    return {
        "state": translator.t(Message.of(code, time=time)),
        "more": f" · {translator.t(Message.of('alarms_more', n=count - 1))}" if count > 1 else "",
        "at": f"/alarms/{alarm.id}",
    }
