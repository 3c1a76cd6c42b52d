"""What a review shows of a command before it is confirmed. Pure.

Of a setpoint: from where to where, within which range, for how long, why the unit cannot take it now, and
risks. Of setting a line to zero: which units take part, and which cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from app.line.commands.rules.setpoint import commanded_setpoint
from app.line.commands.rules.setpoint_range import KIND_OF_PARAMETER, is_above_display, setpoint_range
from app.line.commands.safeguards.limits import Limits
from app.line.commands.scale import scale_text, setpoint_scale
from app.line.commands.values import measure_of_setpoint, setpoint_message
from app.line.live.state.age import unit_link_now
from app.line.live.state.bus_live import BusLive, UnitLive, follower
from app.line.live.state.conditions import bits_of
from app.line.live.state.ramp_time import ramp_parameter, ramp_seconds
from bus.catalogue.numbers import ACCELERATION, DECELERATION, MAX_DISPLAY, RATIO_SETPOINT
from bus.contract import UnitScale
from bus.instants import UnixTime
from bus.messages import Message

REVIEW_LASTS_S = 45.0
"""Thirty seconds on the screen, and something for the way."""
COARSE_STEPS, FINE_STEPS = 100, 1000
"""A nudge is about a hundredth or a thousandth of the full span."""


@dataclass(frozen=True, slots=True)
class Ramp:
    """``number``: the parameter that sets it, #6 or #7. ``tenths``: its raw value, for the full span (#2);
    ``seconds``: for this change. None where it is not known."""

    number: int
    tenths: int | None
    seconds: float | None


def ramp_of(unit: UnitLive, old: int | None, new: int) -> Ramp | None:
    """The ramp between two raw setpoints; None where nothing changes or the unit follows its master."""
    if old == new or follower(unit):
        return None
    number = ramp_parameter(old, new)
    tenths = None if old is None else unit.parameter_raw(number)
    return Ramp(number, tenths, ramp_seconds(unit, old, new))


def present_setpoint(bus: BusLive, unit: UnitLive) -> int | None:
    """The commanded setpoint; of a follower that shows its speed, the command ratio as last read."""
    known = commanded_setpoint(unit, bus)
    return unit.parameter_raw(RATIO_SETPOINT) if known is None and follower(unit) else known


def ramp_parameters_missing(unit: UnitLive) -> list[int]:
    """Parameters to read before the time of a ramp can be given."""
    return [number for number in (MAX_DISPLAY, ACCELERATION, DECELERATION) if number not in unit.parameters]


def nudges(unit: UnitLive) -> tuple[int, int]:
    """(fine, coarse) raw steps that suit the unit's span."""
    span = 10_000 if follower(unit) else unit.parameter_raw(MAX_DISPLAY) or 10_000
    return _round_number(span / FINE_STEPS), _round_number(span / COARSE_STEPS)


def _round_number(size: float) -> int:
    """The largest of 1, 2, 5, 10, 20, … that is not above ``size``."""
    step = 1
    for candidate in (digit * 10**power for power in range(5) for digit in (1, 2, 5)):
        if candidate <= size:
            step = candidate
    return step


def obstacle_of(
    bus: BusLive, unit: UnitLive, now: UnixTime, *, block: Message | None = None
) -> Message | None:
    """The first reason why the unit cannot take a command now, as the next may disappear with it; None where
    nothing is known against it. ``block``: why commands to it are blocked."""
    if block:
        return Message.of("obstacle_blocked", block=block)
    if bus.link.link != "open":
        return Message("obstacle_no_link")
    if unit.reading is None or unit_link_now(bus, unit, now) == "offline":
        return Message("obstacle_offline")
    if not bits_of(bus, unit.reading).remote:
        return Message("obstacle_not_in_remote")
    return None


def risks_of(
    bus: BusLive, unit: UnitLive, now: UnixTime, ramp: Ramp | None, setpoint: int | None = None
) -> tuple[Message, ...]:
    """What of the unit's state may be unexpected, in order of display. ``ramp`` None: the command starts
    none. ``setpoint``: the new one, raw, where an engineer's limit may allow it and #2 does not."""
    found: list[Message] = []
    if setpoint is not None and is_above_display(unit, setpoint):
        found.append(Message("risk_above_display"))
    if unit.reading is not None:
        if unit_link_now(bus, unit, now) == "stale":
            found.append(Message.of("risk_stale", age=round(max(0.0, now - unit.reading.at))))
        bits = bits_of(bus, unit.reading)
        if bits.estop_active:
            found.append(Message("risk_estop_active"))
        if not bits.run:
            found.append(Message("risk_run_off"))
    if ramp is not None and ramp.tenths == 0:
        found.append(Message("risk_no_ramp"))
    if ramp is not None and ramp.seconds is None:
        found.append(Message("risk_ramp_unknown"))
    return tuple(found)


def risks_of_writing(number: int, raw: int) -> tuple[Message, ...]:
    if number in (ACCELERATION, DECELERATION) and raw == 0:
        return (Message("risk_no_ramp"),)
    if number in KIND_OF_PARAMETER:
        return (Message("risk_is_setpoint"),)
    return ()


def by_remark(remarks: Iterable[tuple[str, Message]]) -> list[tuple[Message, list[str]]]:
    """Each remark once, with the names of the units that it is about, in order."""
    found: dict[Message, list[str]] = {}
    for name, remark in remarks:
        found.setdefault(remark, []).append(name)
    return list(found.items())


@dataclass(frozen=True, slots=True)
class SetpointChange:
    """Texts are as the unit shows them, in ``measure``. ``ramp`` None: it has none."""

    unit: int
    name: str
    old_raw: int | None
    new_raw: int
    old: str | Message
    new: str | Message
    measure: str
    lowest: str | Message
    highest: str | Message
    scale: str
    """What it was converted with, as the form of the review holds it."""
    ramp: Ramp | None
    obstacle: Message | None
    risks: tuple[Message, ...]


def change_of(
    bus: BusLive,
    unit: UnitLive,
    new_raw: int,
    limits: Limits,
    now: UnixTime,
    *,
    block: Message | None = None,
    typed_with: UnitScale | None = None,
) -> SetpointChange:
    """What setting ``new_raw`` means for a unit. ``block``: why commands to it are blocked, if they are;
    ``typed_with``: what it was converted with, which the unit may not have any more."""
    old_raw, allowed = present_setpoint(bus, unit), setpoint_range(unit, limits)
    ramp = ramp_of(unit, old_raw, new_raw)
    return SetpointChange(
        unit=unit.settings.id,
        name=unit.settings.name,
        old_raw=old_raw,
        new_raw=new_raw,
        old=setpoint_message(old_raw, unit),
        new=setpoint_message(new_raw, unit),
        measure=measure_of_setpoint(unit),
        lowest=setpoint_message(allowed.lowest, unit),
        highest=setpoint_message(allowed.highest, unit),
        scale=scale_text({**setpoint_scale(unit, new_raw), **(typed_with or {})}),
        ramp=ramp,
        obstacle=obstacle_of(bus, unit, now, block=block),
        risks=risks_of(bus, unit, now, ramp, new_raw),
    )


@dataclass(slots=True)
class ZeroPlan:
    """Setting a bus to zero: every unit ramps to speed 0 by its own #7; followers keep their ratio and come
    down with their master. It is no emergency stop: nothing on this link can run or stop a drive.

    ``units``: address → name. ``left_out`` and ``risks``: name, with its reason or risk."""

    bus: str
    units: dict[int, str] = field(default_factory=dict)
    followers: int = 0
    left_out: list[tuple[str, Message]] = field(default_factory=list)
    risks: list[tuple[str, Message]] = field(default_factory=list)
    seconds: float = 0.0
    """The longest ramp, as far as #2 and #7 are known."""


def plan_zero(bus: BusLive, block: Callable[[int], Message | None], now: UnixTime) -> ZeroPlan:
    """Every master that can take it; the others each with a reason. ``block``: why commands to a unit are
    blocked, None where they are not."""
    plan = ZeroPlan(bus.settings.name)
    for number, unit in bus.units.items():
        name, ramp = unit.settings.name, ramp_of(unit, present_setpoint(bus, unit), 0)
        if follower(unit):
            plan.followers += 1
        elif obstacle := obstacle_of(bus, unit, now, block=block(number)):
            plan.left_out.append((name, obstacle))
        else:
            plan.units[number] = name
            plan.risks += [(name, risk) for risk in risks_of(bus, unit, now, ramp)]
            plan.seconds = max(plan.seconds, (ramp.seconds if ramp else None) or 0.0)
    return plan
