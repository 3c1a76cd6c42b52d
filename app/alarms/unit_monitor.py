"""Observes the conditions of one unit, and only what a report can have changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from app.alarms.alarm import Alarm
from app.alarms.conditions import BY_PARAMETER, BY_READING, BY_VALUE, is_degraded, unit_offline
from app.alarms.own import OwnCondition, known_decimals
from app.alarms.rules.count_window import CountWindow
from app.built_in_settings import BuiltInTuning, UnitAlarm
from app.live.state.age import scan_s_of, stale_after_s, unit_link_now
from app.live.state.bus_live import BusLive, UnitLive
from bus.contract import Reading, UnitFigures
from bus.instants import UnixTime

Observe = Callable[[Alarm, bool | None, UnixTime], None]
"""Takes an alarm, whether its condition holds, and the time."""
OwnAlarms = Sequence[tuple[Alarm, OwnCondition]]
_NEVER = UnixTime(0.0)


class UnitMonitor:
    """Of one unit. ``alarms``: the built-in ones by code, ``tuning`` their limits; ``own``: those of the
    site, which may change while it runs."""

    def __init__(
        self,
        bus: BusLive,
        unit: UnitLive,
        alarms: dict[UnitAlarm, Alarm],
        tuning: Callable[[UnitAlarm], BuiltInTuning],
        own: OwnAlarms,
        observe: Observe,
        has_drift: Callable[[int], bool],
    ) -> None:
        self._bus = bus
        self._unit = unit
        self._alarms = alarms
        self.observe_own(own)
        self._observe = observe
        self._has_drift = has_drift
        self._by_reading = [(alarms[code], holds) for code, holds in BY_READING.items()]
        self._by_value = [(alarms[code], limited(tuning(code))) for code, limited in BY_VALUE.items()]
        self._read_at = _NEVER
        self._status: tuple[int, int, str] | None = None
        """Status bytes and motion of the last reading; None while its values are not known."""
        self._window = CountWindow()

    def observe_own(self, own: OwnAlarms) -> None:
        """Observe these alarms of the site from the next reading on, and no others."""
        self._own = own
        self._own_states = [each for each in own if each[1].of_state]
        self._own_values = [each for each in own if not each[1].of_state]
        self._own_are_new = True

    @property
    def is_known(self) -> bool:
        """Whether the values of the unit are those of now."""
        return self._status is not None

    def clock_stepped(self, step_s: float) -> None:
        """The clock of this machine was set; readings from before it have its former time."""
        self._read_at += step_s

    def see_reading(self, now: UnixTime) -> None:
        """A reading came. One that is late, or repeats one from before, is no evidence of the present."""
        bus, unit, reading = self._bus, self._unit, self._unit.reading
        if reading is None or reading.at <= self._read_at or unit.link.link != "online":
            return
        if now - reading.at > stale_after_s(scan_s_of(bus)):
            return
        self._read_at = reading.at
        status = (reading.outputs, reading.inputs, unit.motion.state)
        if status != self._status or self._own_are_new:
            self._own_are_new = False
            if self._status is None:
                self._observe(self._alarms["unit_offline"], False, now)
            self._status = status
            for alarm, condition in self._by_reading:
                self._observe(alarm, condition(bus, unit), now)
            self._see_own(self._own_states, reading, None, now)
        for alarm, holds in self._by_value:
            found = holds(bus, unit, reading, alarm.facts.active)
            if found is not alarm.holds:
                self._observe(alarm, found, now)
        if self._own_values:
            self._see_own(self._own_values, reading, known_decimals(bus, unit), now)

    def _see_own(self, several: OwnAlarms, reading: Reading, decimals: int | None, now: UnixTime) -> None:
        bus, unit = self._bus, self._unit
        for alarm, own in several:
            holds = own.holds(bus, unit, reading, decimals, alarm.facts.active)
            if holds is not alarm.holds:
                self._observe(alarm, holds, now)

    def see_link(self, now: UnixTime) -> None:
        """Time has passed, or the state of the link has changed."""
        self._observe(self._alarms["unit_offline"], unit_offline(self._bus, self._unit, now), now)
        if self._status is None or unit_link_now(self._bus, self._unit, now) == "online":
            return
        self._status = None
        self._observe(self._alarms["link_degraded"], None, now)
        for alarm in (*(each for each, _ in self._by_reading), *(each for each, _ in self._by_value)):
            self._observe(alarm, None, now)
        for alarm, own in self._own:
            own.forget()
            self._observe(alarm, None, now)

    def see_parameters(self, now: UnixTime) -> None:
        """Parameters were read, or a setpoint was staged or executed."""
        for code, condition in BY_PARAMETER.items():
            self._observe(self._alarms[code], condition(self._bus, self._unit), now)
        drifted = self._has_drift(self._unit.settings.id)
        self._observe(self._alarms["parameter_drift"], drifted, now)

    def see_figures(self, figures: UnitFigures, now: UnixTime) -> None:
        """The counters of the unit."""
        self._window.see(figures.polls, figures.timeouts + figures.checksum_errors, now)
        if self.is_known:
            self._observe(self._alarms["link_degraded"], is_degraded(self._window), now)
