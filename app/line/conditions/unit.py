"""The conditions of a unit, grouped by the facts that decide them. Pure."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from typing import Any

from app.line.conditions.condition import (
    BusValues,
    Condition,
    ConditionEvent,
    CountPredicate,
    DrawPredicate,
    LimitCheck,
    LinkFacts,
    LinkPredicate,
    ParameterPredicate,
    ReadingPredicate,
    Tuning,
    UnitValues,
    ValuePredicate,
    follower,
    reads_ratio,
)
from bus.catalogue.parameters import (
    MAX_DISPLAY,
    MAX_RATIO,
    MIN_RATIO,
    OWN_ADDRESS,
    PARAMETERS,
    RATIO_SETPOINT,
    Parameter,
)
from bus.catalogue.values import plausible_parameter
from bus.contract import Reading
from bus.messages import Message, joined, term

DEGRADED_SHARE = 0.05
"""The share of a minute's polls without a valid response. No operator sees it, and it only gets worse."""
MIN_FAULTS = 3
SETTLED = frozenset(("at_speed", "off_speed"))
RUNNING = SETTLED | {"ramping_up", "ramping_down"}
ANALOG_TOP = 255
"""The highest count of the analog input, which has 8 bits."""


def _ratio_out_of_limits(_: BusValues, unit: UnitValues) -> bool | None:
    if not follower(unit):
        return follower(unit)
    ratio, low, high = (unit.parameter_raw(number) for number in (RATIO_SETPOINT, MIN_RATIO, MAX_RATIO))
    return None if ratio is None or low is None or high is None else not low <= ratio <= high


def suspicion(bus: BusValues, unit: UnitValues) -> Message | None:
    """Return why the values shown for ``unit`` may be those of another; None without a sign of it.

    A response carries only the address that was requested, so one from a unit with a broken address decoder
    looks right. Two signs show it: the address that the responding unit has in its own #17, and that every
    response but its own comes twice. The suspicion warns and forbids nothing: an address changed at the panel
    (#17) may apply from the next power-up only.
    """
    own = unit.parameter_raw(OWN_ADDRESS)
    if own not in (None, unit.settings.id) and _most_read_their_own_address(bus):
        return Message.of("suspect_by_address", unit=own or 0)
    responder = bus.figures.responds_for_all if bus.figures is not None else 0
    if responder not in (0, unit.settings.id):
        return Message.of("suspect_by_duplicates", unit=responder)
    return None


def _most_read_their_own_address(bus: BusValues) -> bool:
    """Return whether most units have their address in #17. If not, #17 has another meaning here, and no
    address can be checked."""
    read = [(unit.parameter_raw(OWN_ADDRESS), unit.settings.id) for unit in bus.units.values()]
    matches = [own == address for own, address in read if own is not None]
    return 2 * sum(matches) > len(matches)


def _deviation(bus: BusValues, unit: UnitValues, reading: Reading, passes: LimitCheck) -> bool | None:
    """Return whether the speed deviates, even while the unit reports AT SPEED; it is unknown while #2 is."""
    if unit.motion.state not in SETTLED or reads_ratio(bus, unit):
        return False
    full_scale, deviation = unit.parameter_raw(MAX_DISPLAY), reading.deviation
    return None if full_scale is None or deviation is None else passes(abs(deviation), full_scale)


def implausible_of(unit: UnitValues) -> Message | None:
    """Return the values of the unit that the manual rules out, as bytes and raw numbers; None without any."""
    found = [
        _implausible_parameter(PARAMETERS[number], value.raw)
        for number, value in unit.parameters.items()
        if value.raw is not None and plausible_parameter(number, value.raw) is None
    ]
    if unit.reading is not None and unit.reading.implausible:
        found.insert(0, Message.of("implausible_status", data=unit.reading.implausible.hex(" ").upper()))
    return joined(found)


def _implausible_parameter(parameter: Parameter, raw: int) -> Message:
    shown = term("hidden") if parameter.secret else raw
    return Message.of("implausible_parameter", number=parameter.number, raw=shown)


def _analog_out_of_limits(_: BusValues, unit: UnitValues, reading: Reading, passes: LimitCheck) -> bool:
    is_wired = bool(unit.settings.labels.analog)
    return is_wired and unit.motion.state in RUNNING and passes(reading.analog, ANALOG_TOP)


def _unit_offline(link: LinkFacts) -> bool | None:
    if not link.bus_is_readable:
        return None
    if not link.is_lost:
        return False if link.is_online else None
    return None if link.is_alone else True


ESTOP_ACTIVE: Condition[ReadingPredicate] = Condition(
    "estop_active",
    ("severe", "minutes"),
    holds=lambda unit: unit.bits.estop_active,
    means="the e-stop input is active",
    group="unit",
    tiles=("estop_active",),
    event=ConditionEvent("estop", "event_estop_input", "event_estop_input", term("healthy"), term("active")),
    rung="e-stop",
    names=("motion",),
    status=lambda bits: bits.estop_active,
)
BY_READING: tuple[Condition[ReadingPredicate], ...] = (
    ESTOP_ACTIVE,
    Condition(
        "running_without_run",
        ("severe", "minutes"),
        holds=lambda unit: unit.motion == "turning",
        means="the motor turns without run and does not slow down",
        tuning=Tuning(on_delay_s=2),
        group="unit",
        tiles=("running_without_run",),
        rung="run",
        since=("run_off", "turning"),
    ),
    Condition(
        "run_off",
        ("major", "minutes"),
        holds=lambda unit: not unit.bits.run and unit.commanded != 0,
        is_alarm=False,
        tiles=("run_off",),
        event=ConditionEvent("run", "event_run_input", "event_run_input", term("on"), term("off")),
        rung="run",
        broken=lambda unit: not unit.bits.run and (unit.commanded != 0 or unit.actual != 0),
        names=("motion",),
        status=lambda bits: not bits.run,
    ),
    Condition(
        "not_in_remote",
        ("minor", "shift"),
        holds=lambda unit: not unit.bits.remote,
        means="the unit is in LOCAL or KEYLOCK",
        tuning=Tuning(on_delay_s=5),
        group="unit",
        tiles=("not_in_remote",),
        event=ConditionEvent("mode", "event_mode", "event_mode", term("REMOTE"), term("LOCAL")),
        rung="mode",
        names=("motion", "mode"),
        status=lambda bits: not bits.remote,
    ),
    Condition(
        "link_stale",
        ("minor", "shift"),
        holds=lambda unit: unit.is_late,
        is_alarm=False,
        tiles=("link_stale",),
        rung="link",
    ),
    Condition(
        "not_at_speed",
        ("major", "minutes"),
        holds=lambda unit: unit.motion == "off_speed" and not unit.is_late,
        means="the unit runs, no longer comes nearer to its commanded speed, and does not report AT SPEED",
        tuning=Tuning(on_delay_s=10, off_delay_s=2),
        group="speed",
        tiles=("not_at_speed",),
        rung="ramp",
        names=("motion",),
        status=lambda bits: not bits.at_speed,
    ),
)
"""Conditions that are judged by each reading, in the order of the ladder."""

BY_VALUE: tuple[Condition[ValuePredicate], ...] = (
    Condition(
        "deviation",
        ("major", "minutes"),
        holds=_deviation,
        means="the unit does not ramp, and its actual speed is more than 5 % of its maximum display value"
        " (parameter 2) away from the commanded one, also where it reports AT SPEED; clears within 4 %",
        tuning=Tuning(Decimal(5), None, Decimal(1), on_delay_s=5, off_delay_s=2),
        group="speed",
    ),
    Condition(
        "analog_out_of_limits",
        ("major", "half_hour"),
        holds=_analog_out_of_limits,
        means="the unit runs, and its analog input, where it has a label, is at an end of its range (0"
        " or 255)",
        # No transducer measures at an end of the 8 bits.
        tuning=Tuning(Decimal("99.6"), Decimal("0.4"), Decimal("1.2"), on_delay_s=5, off_delay_s=5),
        group="speed",
    ),
)
"""Conditions that are judged by each reading and have limits."""

DRAW_OUT_OF_BAND: Condition[DrawPredicate] = Condition(
    "draw_out_of_band",
    ("major", "minutes"),
    holds=lambda draw: None if draw.state in ("unknown", "ramping") else draw.state == "out_of_band",
    means="the actual speed of the unit is to that of the unit before it, while neither stands, in a ratio"
    " outside the band that the site sets (`draw_percent`); while one ramps, the alarm stays as it is;"
    " without a band never",
    tuning=Tuning(on_delay_s=5, off_delay_s=2),
    group="speed",
    tiles=("draw_out_of_band",),
)
"""The condition is judged by each reading of the unit."""

VALUE_IMPLAUSIBLE: Condition[ParameterPredicate] = Condition(
    "value_implausible",
    ("major", "half_hour"),
    about="communication",
    holds=lambda _, unit: implausible_of(unit) is not None,
    means="the unit sends a speed beyond 99999, or a parameter outside of its range in the manual; it is not"
    " stored, and scales nothing",
    tuning=Tuning(off_delay_s=5),
    group="unit",
    tiles=("value_implausible",),
)
"""Judged by the values of a reading as well."""

BY_PARAMETER: tuple[Condition[ParameterPredicate], ...] = (
    VALUE_IMPLAUSIBLE,
    Condition(
        "ratio_out_of_limits",
        ("major", "half_hour"),
        about="parameters",
        holds=_ratio_out_of_limits,
        means="the ratio (parameter 37) of a follower is outside its limits (parameters 38 and 31)",
        group="unit",
    ),
    Condition(
        "duplicate_address",
        ("severe", "half_hour"),
        about="communication",
        holds=lambda bus, unit: suspicion(bus, unit) is not None,
        means="parameter 17 reads as another address, or responses come twice; latched",
        latching=True,
        tiles=("address_suspect",),
    ),
    Condition(
        "staged_left",
        ("major", "half_hour"),
        about="parameters",
        holds=lambda _, unit: unit.staged is not None,
        means="a setpoint was staged (82h) and neither executed nor withdrawn",
        tuning=Tuning(on_delay_s=60),
        group="unit",
    ),
)
"""Conditions that are judged when a parameter is read or a report comes."""

UNIT_OFFLINE: Condition[LinkPredicate] = Condition(
    "unit_offline",
    ("major", "minutes"),
    about="communication",
    holds=_unit_offline,
    means="the unit does not respond, and others of its bus do",
    group="unit",
    tiles=("unit_offline",),
    event=ConditionEvent("unit", "event_unit_lost", "event_unit_back", term("online"), term("offline")),
)
UNIT_UNKNOWN: Condition[Callable[[bool], bool]] = Condition(
    "unit_unknown",
    ("minor", "shift"),
    holds=lambda is_overdue: not is_overdue,
    is_alarm=False,
    tiles=("unit_unknown",),
)
"""Holds for a unit without a response since the start, unless that is overdue."""
LINK_DEGRADED: Condition[CountPredicate] = Condition(
    "link_degraded",
    ("minor", "shift"),
    about="communication",
    holds=lambda polls, faults: faults >= MIN_FAULTS and faults >= DEGRADED_SHARE * polls,
    means="5 % of the polls of a minute, and three at least, had no valid response",
    tuning=Tuning(off_delay_s=60),
    group="unit",
)
PARAMETER_DRIFT: Condition[Callable[[object], bool]] = Condition(
    "parameter_drift",
    ("major", "shift"),
    about="parameters",
    holds=bool,
    means="a parameter differs from the golden set",
    tiles=("drift",),
)
"""The condition is judged by the unit's differences from its golden set."""
BLOCKED: Condition[Callable[[object], bool]] = Condition(
    "blocked",
    ("minor", "shift"),
    holds=bool,
    is_alarm=False,
    tiles=("blocked",),
)
"""The condition is judged by the reason for a block."""

OF_UNIT: tuple[Condition[Any], ...] = (
    *BY_READING,
    *BY_VALUE,
    DRAW_OUT_OF_BAND,
    *BY_PARAMETER,
    UNIT_OFFLINE,
    UNIT_UNKNOWN,
    LINK_DEGRADED,
    PARAMETER_DRIFT,
    BLOCKED,
)
