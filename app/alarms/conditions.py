"""Whether the condition of each built-in alarm holds. Pure: live state and time in; None: not known."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from functools import cache

from app.alarms.rules.count_window import CountWindow
from app.alarms.rules.limits import LimitRule
from app.built_in_settings import BuiltInTuning, BusAlarm, UnitAlarm
from app.live.diagnosis.abnormal import suspicion
from app.live.diagnosis.cause import bus_cause
from app.live.state.age import offline_after_s, scan_s_of, unit_link_now
from app.live.state.bus_live import BusLive, UnitLive, follower, reads_ratio
from bus.catalogue.numbers import MAX_DISPLAY, MAX_RATIO, MIN_RATIO, RATIO_SETPOINT
from bus.contract import Reading
from bus.contract.durations import POLL_BYTES
from bus.instants import Monotonic, UnixTime
from bus.settings import wire_seconds

DEGRADED_SHARE = 0.05
"""Of the polls of a minute without a valid response: an operator cannot see it, and it only gets worse."""
FEWEST_FAULTS = 3
UnitCondition = Callable[[BusLive, UnitLive], bool | None]

BY_READING: dict[UnitAlarm, UnitCondition] = {
    "estop_active": lambda _, unit: "estop_active" in unit.onsets.of,
    "not_in_remote": lambda _, unit: "not_in_remote" in unit.onsets.of,
    "not_at_speed": lambda _, unit: unit.motion.state == "off_speed",
    "running_without_run": lambda _, unit: unit.motion.state == "turning",
}
"""Conditions of a reading that is live."""


def ratio_out_of_limits(_: BusLive, unit: UnitLive) -> bool | None:
    """Whether the ratio setpoint (#37) of a follower is outside #38 and #31."""
    if not follower(unit):
        return follower(unit)
    ratio, low, high = (unit.parameter_raw(number) for number in (RATIO_SETPOINT, MIN_RATIO, MAX_RATIO))
    if ratio is None or low is None or high is None:
        return None
    return not low <= ratio <= high


RUNNING = frozenset(("at_speed", "off_speed", "ramping_up", "ramping_down"))
SETTLED = frozenset(("at_speed", "off_speed"))
ANALOG_TOP = 255
"""The analog input in counts of 8 bits."""
ValueCondition = Callable[[BusLive, UnitLive, Reading, bool], bool | None]


def deviation(tuning: BuiltInTuning) -> ValueCondition:
    """Whether the speed of a unit that does not ramp is away from the commanded one, also where the unit
    itself reports AT SPEED; not known while #2 is not. Limits are of #2."""

    @cache
    def rule(full_scale: int) -> LimitRule:
        found = _rule_of(tuning, full_scale)
        return LimitRule(max(1, found.above or 0), None, found.deadband)

    def holds(bus: BusLive, unit: UnitLive, reading: Reading, active: bool) -> bool | None:
        if unit.motion.state not in SETTLED or reads_ratio(bus, unit):
            return False
        full_scale = unit.parameter_raw(MAX_DISPLAY)
        if full_scale is None:
            return None
        return rule(full_scale).holds(abs(reading.commanded - reading.actual), active)

    return holds


def analog_out_of_limits(tuning: BuiltInTuning) -> ValueCondition:
    """Whether an analog input that is wired is outside its limits while the unit runs."""
    rule = _rule_of(tuning, ANALOG_TOP)

    def holds(_: BusLive, unit: UnitLive, reading: Reading, active: bool) -> bool:
        if not unit.settings.labels.analog or unit.motion.state not in RUNNING:
            return False
        return rule.holds(reading.analog, active)

    return holds


def _rule_of(tuning: BuiltInTuning, top: int) -> LimitRule:
    def raw(percent: Decimal | None) -> int | None:
        return None if percent is None else round(percent * top / 100)

    above, below = raw(tuning.above_percent), raw(tuning.below_percent)
    return LimitRule(above, below, raw(tuning.deadband_percent) or 0)


BY_VALUE: dict[UnitAlarm, Callable[[BuiltInTuning], ValueCondition]] = {
    "deviation": deviation,
    "analog_out_of_limits": analog_out_of_limits,
}
"""Conditions of every reading that is live, by their limits; the last argument: whether it is active."""

BY_PARAMETER: dict[UnitAlarm, UnitCondition] = {
    "ratio_out_of_limits": ratio_out_of_limits,
    "duplicate_address": lambda bus, unit: suspicion(bus, unit) is not None,
    "staged_left": lambda _, unit: unit.staged is not None,
}
"""Conditions of what is read or reported now and then."""


def unit_offline(bus: BusLive, unit: UnitLive, now: UnixTime) -> bool | None:
    """Whether a unit does not respond; not known while its bus cannot be read, or no unit of it responds."""
    if bus_cause(bus, now) is not None:
        return None
    lost_at = _lost_at(bus, unit, now)
    if lost_at is None:
        return False if unit_link_now(bus, unit, now) == "online" else None
    return True if len(bus.units) == 1 or _has_response_after(bus, lost_at) else None


def _lost_at(bus: BusLive, unit: UnitLive, now: UnixTime) -> UnixTime | None:
    """When a unit was found not to respond; None: it was not."""
    if unit.reading is not None and unit.link.link == "offline":
        return unit.link.at
    seen_at = bus.link_onset.at if unit.reading is None else unit.reading.at
    lost_at = seen_at + offline_after_s(scan_s_of(bus))
    return lost_at if now > lost_at else None


def _has_response_after(bus: BusLive, at: UnixTime) -> bool:
    return any(unit.reading is not None and unit.reading.at > at for unit in bus.units.values())


def bus_conditions(bus: BusLive, now: UnixTime) -> dict[BusAlarm, bool | None]:
    """Those of the bus that time alone can change."""
    cause = bus_cause(bus, now)
    worker_lost = cause is not None and cause.code in ("worker_lost", "worker_silent")
    port_lost = None if worker_lost else cause is not None
    no_unit_responds = None if cause is not None else has_no_response(bus, now)
    return {
        "worker_lost": worker_lost,
        "port_lost": port_lost,
        "no_unit_responds": no_unit_responds,
        "wire_overloaded": wire_overloaded(bus) if cause is None else None,
    }


def has_no_response(bus: BusLive, now: UnixTime) -> bool:
    """Whether no unit of several has responded since one was found lost. Where only that one is lost, the
    next response of another ends it."""
    if len(bus.units) == 1:
        return False
    lost = (_lost_at(bus, unit, now) for unit in bus.units.values())
    return any(at is not None and not _has_response_after(bus, at) for at in lost)


SCAN_BUDGET = 1.5
"""Of the time in which every unit is polled once and takes its full turnaround."""


def wire_overloaded(bus: BusLive) -> bool | None:
    """Whether a scan takes longer than the cable and its units explain."""
    if bus.figures is None:
        return None
    at_worst = len(bus.units) * (wire_seconds(POLL_BYTES, bus.baud) + bus.settings.turnaround_s)
    return bus.figures.scan_s > SCAN_BUDGET * at_worst


CONTROL_IDLE_S = 120.0


def control_is_left(used_at: Monotonic, now: Monotonic, *, has_page: bool) -> bool:
    """Whether a holder of control has no page open and has sent no command for a while."""
    return not has_page and now - used_at > CONTROL_IDLE_S


def is_degraded(window: CountWindow) -> bool | None:
    """Whether many polls of the last minute had no valid response."""
    if window.total is None or window.faults is None:
        return None
    return window.faults >= FEWEST_FAULTS and window.faults >= DEGRADED_SHARE * window.total


def has_foreign(window: CountWindow) -> bool | None:
    """Whether responses came in the last minute that no one here had requested."""
    return None if window.faults is None else window.faults >= FEWEST_FAULTS
