"""Observes the conditions of one unit, and only what a report can have changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial

from app.line.alarms.alarm import Alarm, key_of
from app.line.alarms.own.definition import OwnCondition, known_decimals
from app.line.alarms.rules.detection import CountWindow, LimitRule, limits_of
from app.line.alarms.settings import BuiltInAlarmSettings, tuning_of
from app.line.conditions import of_unit
from app.line.conditions.catalogue import UNIT_ALARMS
from app.line.conditions.condition import Tuning
from app.line.conditions.evidence import LimitCheck
from app.line.live.diagnosis.links import link_facts, unit_facts
from app.line.live.state.bus_live import BusLive, UnitLive
from app.line.live.state.draw import draw_of
from app.line.live.state.scan_time import scan_s_of, stale_after_s
from bus.contract import Reading, UnitFigures
from bus.instants import UnixTime
from bus.messages import Message

Observe = Callable[[Alarm, bool | None, UnixTime], None]
"""Takes an alarm, whether its condition holds, and the time."""
ObservedOwn = tuple[Alarm, OwnCondition]
_NEVER = UnixTime(0.0)


class UnitMonitor:
    """Observes one unit. ``alarms``: of its bus, by key; ``tuned``: the limits that the site set."""

    def __init__(
        self,
        bus: BusLive,
        unit: UnitLive,
        alarms: Mapping[str, Alarm],
        tuned: Sequence[BuiltInAlarmSettings],
        observe: Observe,
        has_drift: Callable[[int], bool],
    ) -> None:
        self._bus = bus
        self._unit = unit
        place = (bus.settings.name, unit.settings.id)
        self._alarms = {code: alarms[key_of(*place, code)] for code in UNIT_ALARMS}
        self._own: dict[str, ObservedOwn] = {}
        self._sort_own()
        self._observe = observe
        self._has_drift = has_drift
        self._by_reading = [(self._alarms[row.code], row.holds) for row in of_unit.BY_READING if row.is_alarm]
        self._by_value = [
            (alarm, row.holds, _limit_check(alarm, tuning_of(tuned, row.code, *place)))
            for row in of_unit.BY_VALUE
            for alarm in (self._alarms[row.code],)
        ]
        self._draw = self._alarms[of_unit.DRAW_OUT_OF_BAND.code]
        self._implausible = self._alarms[of_unit.VALUE_IMPLAUSIBLE.code]
        self._offline = self._alarms[of_unit.UNIT_OFFLINE.code]
        self._degraded = self._alarms[of_unit.LINK_DEGRADED.code]
        self._drift = self._alarms[of_unit.PARAMETER_DRIFT.code]
        self._read_at = _NEVER
        self._status: tuple[int, int, str] | None = None
        """Status bytes and motion of the last reading; None while its values are not known."""
        self._window = CountWindow()

    def add_own(self, alarm: Alarm, condition: OwnCondition) -> None:
        """Observe an alarm of the site from the next reading on."""
        self._own[alarm.definition.key] = (alarm, condition)
        self._sort_own()

    def end_own(self, alarm: Alarm) -> None:
        """Observe an alarm of the site no longer."""
        del self._own[alarm.definition.key]
        self._sort_own()

    def _sort_own(self) -> None:
        self._own_states = [each for each in self._own.values() if each[1].of_state]
        self._own_values = [each for each in self._own.values() if not each[1].of_state]
        self._own_are_new = True

    def alarms(self) -> list[Alarm]:
        """All alarms of the unit."""
        return [*self._alarms.values(), *(alarm for alarm, _ in self._own.values())]

    def present(self, alarm: Alarm) -> Message | None:
        """The present value of what an alarm is about, where it is about one."""
        if alarm is self._implausible:
            return of_unit.implausible_of(self._unit)
        own = self._own.get(alarm.definition.key)
        return None if own is None else own[1].present(self._bus, self._unit)

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
                self._observe(self._offline, False, now)
            self._status = status
            facts = unit_facts(bus, unit, reading)
            for alarm, condition in self._by_reading:
                self._observe(alarm, condition(facts), now)
            self._see_own(self._own_states, reading, None, now)
        self._see_values(reading, now)
        if self._own_values:
            self._see_own(self._own_values, reading, known_decimals(bus, unit), now)

    def _see_values(self, reading: Reading, now: UnixTime) -> None:
        bus, unit = self._bus, self._unit
        found = [(alarm, holds(bus, unit, reading, passes)) for alarm, holds, passes in self._by_value]
        found.append((self._implausible, of_unit.VALUE_IMPLAUSIBLE.holds(bus, unit)))
        found.append((self._draw, of_unit.DRAW_OUT_OF_BAND.holds(draw_of(bus, unit, now))))
        for alarm, is_held in found:
            if is_held is not alarm.holds:
                self._observe(alarm, is_held, now)

    def _see_own(
        self, several: Sequence[ObservedOwn], reading: Reading, decimals: int | None, now: UnixTime
    ) -> None:
        bus, unit = self._bus, self._unit
        for alarm, own in several:
            holds = own.holds(bus, unit, reading, decimals, alarm.facts.active)
            if holds is not alarm.holds:
                self._observe(alarm, holds, now)

    def see_link(self, now: UnixTime, *, bus_is_readable: bool) -> bool:
        """Time has passed, or the state of the link has changed. Whether the unit is lost, and no other has
        responded since."""
        link = link_facts(self._bus, self._unit, now, bus_is_readable=bus_is_readable)
        self._observe(self._offline, of_unit.UNIT_OFFLINE.holds(link), now)
        if link.is_lost or not bus_is_readable:
            # That is an alarm itself; what was not responded to meanwhile is no poor connection as well.
            self._window.restart()
        if self._status is not None and not link.is_online:
            self._lose_values(now)
        return link.is_alone

    def _lose_values(self, now: UnixTime) -> None:
        """The values of the unit are not those of now any more."""
        self._status = None
        self._observe(self._degraded, None, now)
        self._observe(self._draw, None, now)
        self._observe(self._implausible, None, now)
        for alarm in (*(each for each, _ in self._by_reading), *(each for each, *_ in self._by_value)):
            self._observe(alarm, None, now)
        for alarm, own in self._own.values():
            own.forget()
            self._observe(alarm, None, now)

    def see_parameters(self, now: UnixTime) -> None:
        """Parameters were read, or a setpoint was staged or executed."""
        for row in of_unit.BY_PARAMETER:
            self._observe(self._alarms[row.code], row.holds(self._bus, self._unit), now)
        self.see_drift(now)

    def see_drift(self, now: UnixTime) -> None:
        """Observe drift: the golden set or the parameters that differ from it may have changed."""
        drifted = self._has_drift(self._unit.settings.id)
        self._observe(self._drift, of_unit.PARAMETER_DRIFT.holds(drifted), now)

    def see_figures(self, figures: UnitFigures, now: UnixTime) -> None:
        """The counters of the unit."""
        self._window.see(figures.polls, figures.timeouts + figures.checksum_errors, now)
        if self.is_known:
            self._observe(self._degraded, self._window.judged(of_unit.LINK_DEGRADED.holds), now)


def _limit_check(alarm: Alarm, tuning: Tuning) -> LimitCheck:
    """Return the check of a value against the limits of the site, which are computed once for a full
    scale."""
    rule = _rules(tuning)
    return lambda value, full_scale: rule(full_scale).holds(value, alarm.facts.active)


@cache
def _rules(tuning: Tuning) -> Callable[[int], LimitRule]:
    """Return the rules of a tuning, shared by all units with the same limits: a line has a thousand such
    alarms."""
    return cache(partial(limits_of, tuning))
