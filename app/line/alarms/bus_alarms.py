"""The alarms of one bus and its units: from what a worker reports to transitions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from app.core.web.access import account_shown
from app.line.alarms.alarm import Alarm, AlarmDefinition, alarm_key, built_in
from app.line.alarms.alarm_list import AlarmList
from app.line.alarms.journal import AlarmStore, StoredAlarm
from app.line.alarms.own_condition import OwnCondition, known_decimals, own_definition
from app.line.alarms.rules import CountWindow, Suppressors, is_at_rest, limits_of
from app.line.alarms.settings import AlarmSettings, BuiltInAlarmSettings, tuning_of
from app.line.conditions import unit as unit_conditions
from app.line.conditions.catalogue import (
    BUS_ALARMS,
    BY_BUS,
    CONDITIONS,
    CONTROL_LEFT,
    SECOND_MASTER,
    UNIT_ALARMS,
)
from app.line.conditions.condition import LimitCheck, Tuning
from app.line.conditions.unit import ESTOP_ACTIVE
from app.line.live.bus_live import (
    NO_WORKER,
    Audience,
    BusLive,
    UnitLive,
    draw_numbers,
    offline_after_s,
    scan_s_of,
    stale_after_s,
)
from app.line.live.diagnosis import bus_facts, link_facts, unit_facts
from bus.contract import BusFigures, BusLink, ParameterValue, Reading, Staged, UnitFigures, UnitLink, Update
from bus.instants import Clock, ClockWatch, Monotonic, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message

Observe = Callable[[Alarm, bool | None, UnixTime], None]
"""A function that takes an alarm, whether its condition holds (None: not known), and the time."""
ObservedOwn = tuple[Alarm, OwnCondition]
_NEVER = UnixTime(0.0)


class BusAlarms:
    """The alarms of one bus, detected and suppressed. ``has_drift`` returns whether a unit differs from its
    golden set, None while that is not known; ``left_control`` who has left control without releasing it;
    ``tuned``: limits and delays of the built-in alarms. Call :meth:`load` before the first update."""

    def __init__(
        self,
        live: BusLive,
        own: Iterable[AlarmSettings],
        store: AlarmStore,
        has_drift: Callable[[int], bool | None],
        left_control: Callable[[], Message | None] = lambda: None,
        clock: Clock = unix_now,
        monotonic: MonotonicClock = monotonic_now,
        tuned: Sequence[BuiltInAlarmSettings] = (),
    ) -> None:
        self.bus = live.settings.name
        self._live = live
        self._clock, self._monotonic = clock, monotonic
        self._unit_names = {number: unit.settings.name for number, unit in live.units.items()}
        self.list = AlarmList(self._definitions(tuned), store, self.bus)
        self._monitors = {
            number: _UnitMonitor(live, unit, self.list.alarms, tuned, self._observe, has_drift)
            for number, unit in live.units.items()
        }
        for settings in own:
            self.add_own(settings, Alarm(own_definition(settings)))
        self._unrequested = CountWindow()
        self._second_master, self._control_left = map(self._alarm_of, (SECOND_MASTER.code, CONTROL_LEFT.code))
        self._estops: set[int] = set()
        self._lost_alone: set[int] = set()
        """Lost units. The next response of another unit shows whether the fault is theirs alone."""
        self._suppressors = Suppressors()
        self._clock_watch = ClockWatch(clock(), monotonic())
        self._ages_from = Monotonic(0.0)
        """The time before which ages mean nothing, because the clock was set."""
        self._left_control = left_control
        self.list.subscribe(self._on_alarm)
        live.subscribe(Audience.ALARMS, self._see)

    def _definitions(self, tuned: Sequence[BuiltInAlarmSettings]) -> Iterable[AlarmDefinition]:
        for bus_code in BUS_ALARMS:
            yield built_in(bus_code, self.bus, None, tuned)
        for unit in self._live.units:
            for code in UNIT_ALARMS:
                yield built_in(code, self.bus, unit, tuned)

    def _alarm_of(self, code: str) -> Alarm:
        return self.list.alarms[alarm_key(self.bus, None, code)]

    def add_own(self, settings: AlarmSettings, alarm: Alarm) -> None:
        """Observe an alarm of the site from the next reading on."""
        self.list.add(alarm)
        self._monitors[settings.unit].add_own(alarm, OwnCondition(settings))

    def end_own(self, alarm: Alarm) -> None:
        """Stop observing an alarm of the site, which stays in the list."""
        self._monitors[alarm.definition.unit or 0].end_own(alarm)
        alarm.holds = None

    def load(self, stored: Mapping[str, StoredAlarm]) -> None:
        """Continue from the states that the last run left."""
        now = self._clock()
        self.list.load(stored, now)
        estop_alarms = {unit: alarm_key(self.bus, unit, ESTOP_ACTIVE.code) for unit in self._monitors}
        self._estops |= {unit for unit, key in estop_alarms.items() if self.list.alarms[key].facts.active}
        self._suppressors = self._suppressing()
        self._suppress(self.list.alarms.values(), now)

    def present(self, alarm: Alarm) -> Message | None:
        """Return the present value or cause that an alarm is about; None if it is about none."""
        if alarm is self._control_left:
            return self._left_control()
        if alarm.definition.code == "worker_lost":
            cause = self._live.link.cause
            return None if self._live.worker_connected or cause == NO_WORKER else cause
        monitor = self._monitors.get(alarm.definition.unit or 0)
        return None if monitor is None else monitor.present(alarm)

    def place(self, unit: int | None) -> str:
        """Return the name of a unit, or (None) of the bus."""
        return self.bus if unit is None else self._unit_names[unit]

    def unit_names(self) -> Mapping[int, str]:
        """Return the names that people gave the units, by their addresses."""
        return self._unit_names

    async def follow(self) -> None:
        """Observe what time changes, and keep the journal, until canceled."""
        await self.list.follow(self.tick, self._clock)

    def tick(self) -> None:
        """Observe what time alone has changed: links, drift, control and the clock."""
        now = self._clock()
        self._notice_step(now)
        if self._monotonic() >= self._ages_from:
            self._observe_links(now)
        for monitor in self._monitors.values():
            monitor.observe_drift(now)
        self._observe(self._control_left, self._left_control() is not None, now)
        self._suppress_again(now)

    def _notice_step(self, now: UnixTime) -> None:
        running = self._monotonic()
        if step_s := self._clock_watch.step(now, running):
            self._ages_from = running + offline_after_s(scan_s_of(self._live))
            self.list.clock_stepped(step_s)
            for monitor in self._monitors.values():
                monitor.clock_stepped(step_s)

    # --- what the worker reports ----------------------------------------------------------------------

    def _see(self, updates: Sequence[Update]) -> None:
        now = self._clock()
        read: set[int] = set()
        for update in updates:
            match update:
                case Reading() if update.unit in self._monitors:
                    self._monitors[update.unit].observe_reading(now)
                case UnitLink() if update.unit in self._monitors:
                    self._observe_link(update.unit, now, bus_is_readable=self._observe_bus(now))
                case ParameterValue() | Staged() if update.unit in self._monitors:
                    read.add(update.unit)
                case BusLink():
                    self._observe_bus(now)
                case BusFigures():
                    self._observe_figures(update, now)
        for unit in read:
            self._monitors[unit].observe_parameters(now)
        if self._lost_alone:
            self._observe_links(now)

    def _observe(self, alarm: Alarm, holds: bool | None, now: UnixTime) -> None:
        """Observe a condition. A suppression begins before the alarm rises, so that it is never
        annunciated."""
        if holds and not alarm.holds and self._suppresses(alarm):
            self.list.suppress(alarm, True, now)
        self.list.observe(alarm, holds, now)

    def _observe_bus(self, now: UnixTime) -> bool:
        """Observe the conditions of the bus, and return whether it can be read."""
        facts = bus_facts(self._live, now)
        for row in BY_BUS:
            self._observe(self._alarm_of(row.code), row.holds(facts), now)
        return facts.is_readable

    def _observe_links(self, now: UnixTime) -> None:
        is_readable = self._observe_bus(now)
        for unit in self._monitors:
            self._observe_link(unit, now, bus_is_readable=is_readable)

    def _observe_link(self, unit: int, now: UnixTime, *, bus_is_readable: bool) -> None:
        if self._monitors[unit].observe_link(now, bus_is_readable=bus_is_readable):
            self._lost_alone.add(unit)
        else:
            self._lost_alone.discard(unit)

    def _observe_figures(self, figures: BusFigures, now: UnixTime) -> None:
        for unit in figures.units:
            if unit.unit in self._monitors:
                self._monitors[unit.unit].observe_figures(unit, now)
        self._unrequested.see(0, figures.unrequested, now)
        is_present = figures.has_second_master or self._unrequested.judged(SECOND_MASTER.holds)
        self._observe(self._second_master, is_present, now)

    # --- suppression ----------------------------------------------------------------------------------

    def _on_alarm(self, alarm: Alarm) -> None:
        code, unit = alarm.definition.code, alarm.definition.unit
        if unit is None and CONDITIONS[code].suppresses:
            self._suppress_again(self._clock())
        elif code == ESTOP_ACTIVE.code and unit is not None and alarm.facts.active != (unit in self._estops):
            self._estops ^= {unit}
            self._suppress(self._monitors[unit].alarms(), self._clock())

    def _suppress_again(self, now: UnixTime) -> None:
        """Decide the suppression of every alarm again if what suppresses on the bus has changed."""
        found = self._suppressing()
        if found != self._suppressors:
            self._suppressors = found
            self._suppress(self.list.alarms.values(), now)

    def _suppress(self, alarms: Iterable[Alarm], now: UnixTime) -> None:
        """Decide the suppression of alarms, except those that are neither active nor about to be."""
        for alarm in alarms:
            concerned = alarm.facts.suppressed or alarm.facts.active or bool(alarm.holds)
            self.list.suppress(alarm, concerned and self._suppresses(alarm), now)

    def _suppresses(self, alarm: Alarm) -> bool:
        definition = alarm.definition
        return self._suppressors.suppress(definition.group, definition.unit)

    def _suppressing(self) -> Suppressors:
        readings = (unit.reading for unit in self._live.units.values())
        holding = [row for row in BY_BUS if self._alarm_of(row.code).facts.active]
        return Suppressors(
            groups=frozenset(group for row in holding for group in row.suppresses),
            at_rest=is_at_rest(None if reading is None else reading.commanded for reading in readings),
            estops=self._estops,
        )


def control_left_by(
    holder: str, used_at: Monotonic, present: Collection[str], now: Monotonic
) -> Message | None:
    """Return a message with the holder who has left control without releasing it, or None. ``used_at``: when
    the holder last sent a command; ``present``: the accounts with an open page."""
    if not CONTROL_LEFT.holds(now - used_at, holder in present):
        return None
    return Message.of("alarm_control_left_by", who=account_shown(holder))


class _UnitMonitor:
    """The monitor of one unit's conditions, which observes those that a report can have changed. ``alarms``:
    those of its bus, by key; ``tuned``: the limits that the site set."""

    def __init__(
        self,
        bus: BusLive,
        unit: UnitLive,
        alarms: Mapping[str, Alarm],
        tuned: Sequence[BuiltInAlarmSettings],
        observe: Observe,
        has_drift: Callable[[int], bool | None],
    ) -> None:
        self._bus = bus
        self._unit = unit
        place = (bus.settings.name, unit.settings.id)
        self._alarms = {code: alarms[alarm_key(*place, code)] for code in UNIT_ALARMS}
        self._own: dict[str, ObservedOwn] = {}
        self._sort_own()
        self._observe = observe
        self._has_drift = has_drift
        self._by_reading = [
            (self._alarms[row.code], row.holds) for row in unit_conditions.BY_READING if row.is_alarm
        ]
        self._by_value = [
            (alarm, row.holds, _limit_check(alarm, tuning_of(tuned, row.code, *place)))
            for row in unit_conditions.BY_VALUE
            for alarm in (self._alarms[row.code],)
        ]
        self._draw = self._alarms[unit_conditions.DRAW_OUT_OF_BAND.code]
        self._implausible = self._alarms[unit_conditions.VALUE_IMPLAUSIBLE.code]
        self._offline = self._alarms[unit_conditions.UNIT_OFFLINE.code]
        self._degraded = self._alarms[unit_conditions.LINK_DEGRADED.code]
        self._drift = self._alarms[unit_conditions.PARAMETER_DRIFT.code]
        self._read_at = _NEVER
        self._status: tuple[int, int, str, bytes] | None = None
        """Status bytes, motion and implausible bytes of the last reading; None while its values are
        unknown."""
        self._window = CountWindow()

    def add_own(self, alarm: Alarm, condition: OwnCondition) -> None:
        """Observe an alarm of the site from the next reading on."""
        self._own[alarm.definition.key] = (alarm, condition)
        self._sort_own()

    def end_own(self, alarm: Alarm) -> None:
        """Stop observing an alarm of the site."""
        del self._own[alarm.definition.key]
        self._sort_own()

    def _sort_own(self) -> None:
        self._own_states = [each for each in self._own.values() if each[1].of_state]
        self._own_values = [each for each in self._own.values() if not each[1].of_state]
        self._own_are_new = True

    def alarms(self) -> list[Alarm]:
        """Return all alarms of the unit."""
        return [*self._alarms.values(), *(alarm for alarm, _ in self._own.values())]

    def present(self, alarm: Alarm) -> Message | None:
        """Return the present value that an alarm is about; None if it is about none."""
        if alarm is self._implausible:
            return unit_conditions.implausible_of(self._unit)
        if alarm is self._draw:
            return draw_numbers(self._bus, self._unit, self._unit.draw)
        own = self._own.get(alarm.definition.key)
        return None if own is None else own[1].present(self._bus, self._unit)

    @property
    def is_known(self) -> bool:
        """Whether the last values of the unit are current."""
        return self._status is not None

    def clock_stepped(self, step_s: float) -> None:
        """Move the time of the last reading with the clock of this machine, which was set."""
        self._read_at += step_s

    def observe_reading(self, now: UnixTime) -> None:
        """Observe the last reading, unless it is late or repeats an earlier one, which shows nothing of the
        present."""
        bus, unit, reading = self._bus, self._unit, self._unit.reading
        if reading is None or reading.at <= self._read_at or unit.link.link != "online":
            return
        if now - reading.at > stale_after_s(scan_s_of(bus)):
            return
        self._read_at = reading.at
        status = (reading.outputs, reading.inputs, unit.motion.state, reading.implausible)
        if status != self._status or self._own_are_new:
            self._own_are_new = False
            if self._status is None:
                self._observe(self._offline, False, now)
            self._status = status
            facts = unit_facts(bus, unit, reading)
            for alarm, condition in self._by_reading:
                self._observe(alarm, condition(facts), now)
            self._observe(self._implausible, unit_conditions.VALUE_IMPLAUSIBLE.holds(bus, unit), now)
            self._observe_own(self._own_states, reading, None, now)
        self._observe_values(reading, now)
        if self._own_values:
            self._observe_own(self._own_values, reading, known_decimals(bus, unit), now)

    def _observe_values(self, reading: Reading, now: UnixTime) -> None:
        bus, unit = self._bus, self._unit
        found = [(alarm, holds(bus, unit, reading, passes)) for alarm, holds, passes in self._by_value]
        found.append((self._draw, unit_conditions.DRAW_OUT_OF_BAND.holds(unit.draw)))
        for alarm, is_held in found:
            self._observe(alarm, is_held, now)

    def _observe_own(
        self, several: Sequence[ObservedOwn], reading: Reading, decimals: int | None, now: UnixTime
    ) -> None:
        bus, unit = self._bus, self._unit
        for alarm, own in several:
            self._observe(alarm, own.holds(bus, unit, reading, decimals, alarm.facts.active), now)

    def observe_link(self, now: UnixTime, *, bus_is_readable: bool) -> bool:
        """Observe the link after time has passed, or its state has changed. Return whether the unit is lost
        and no other has responded since."""
        link = link_facts(self._bus, self._unit, now, bus_is_readable=bus_is_readable)
        self._observe(self._offline, unit_conditions.UNIT_OFFLINE.holds(link), now)
        if link.is_lost or not bus_is_readable:
            # The loss is an alarm itself: requests without a response meanwhile are no poor connection as
            # well.
            self._window.restart()
        if self._status is not None and not link.is_online:
            self._lose_values(now)
        return link.is_alone

    def _lose_values(self, now: UnixTime) -> None:
        """Observe that the values of the unit are not known any more."""
        self._status = None
        self._observe(self._degraded, None, now)
        self._observe(self._draw, None, now)
        self._observe(self._implausible, None, now)
        for alarm in (*(each for each, _ in self._by_reading), *(each for each, *_ in self._by_value)):
            self._observe(alarm, None, now)
        for alarm, own in self._own.values():
            own.forget()
            self._observe(alarm, None, now)

    def observe_parameters(self, now: UnixTime) -> None:
        """Observe conditions of parameters, or of a setpoint that was staged or executed."""
        for row in unit_conditions.BY_PARAMETER:
            self._observe(self._alarms[row.code], row.holds(self._bus, self._unit), now)
        self.observe_drift(now)

    def observe_drift(self, now: UnixTime) -> None:
        """Observe drift: the golden set or the parameters that differ from it may have changed."""
        drifted = self._has_drift(self._unit.settings.id)
        holds = None if drifted is None else unit_conditions.PARAMETER_DRIFT.holds(drifted)
        self._observe(self._drift, holds, now)

    def observe_figures(self, figures: UnitFigures, now: UnixTime) -> None:
        """Observe the alarms that depend on the unit's counters."""
        self._window.see(figures.polls, figures.timeouts + figures.checksum_errors, now)
        if self.is_known:
            self._observe(self._degraded, self._window.judged(unit_conditions.LINK_DEGRADED.holds), now)


def _limit_check(alarm: Alarm, tuning: Tuning) -> LimitCheck:
    """Return a function that checks a value of a full scale against the limits of an alarm."""
    return lambda value, full_scale: limits_of(tuning, full_scale).holds(value, alarm.facts.active)
