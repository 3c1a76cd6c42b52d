"""Setting a whole line to zero: which units are told, and which cannot be. Pure.

It commands speed 0 and every unit ramps by its own #7. It is no emergency stop: nothing on this link
can run or stop a drive. Followers keep their ratio and come down with their master.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from app.commands.ramp import MAX_DISPLAY, RAMP_DOWN
from app.live.age import unit_link_now
from app.live.conditions import bits_of
from app.live.state import BusLive, UnitLive, follower


@dataclass(slots=True)
class ZeroPlan:
    """For one bus. ``left_out``: name → why it is not told."""

    bus: str
    units: dict[int, str] = field(default_factory=dict)
    followers: int = 0
    left_out: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    """The longest ramp, as far as #2 and #7 are known."""


def plan_zero(bus: BusLive, blocked: Callable[[int], bool], now: float) -> ZeroPlan:
    """Everyone who can be told, masters only; the others each with a reason."""
    plan = ZeroPlan(bus.settings.name)
    for number, unit in bus.units.items():
        reason = why_not_told(bus, unit, blocked(number), now)
        if follower(unit):
            plan.followers += 1
        elif reason:
            plan.left_out[unit.settings.name] = reason
        else:
            plan.units[number] = unit.settings.name
            plan.seconds = max(plan.seconds, _seconds(unit))
    return plan


def why_not_told(bus: BusLive, unit: UnitLive, blocked: bool, now: float) -> str:
    """Why a unit would not take a speed now; empty where nothing is known against it."""
    if blocked:
        return "blocked"
    if bus.link.link == "closed" or unit.reading is None or unit_link_now(bus, unit, now) == "offline":
        return "does not answer"
    return "" if bits_of(bus, unit.reading).remote else "not in REMOTE"


def _seconds(unit: UnitLive) -> float:
    span, tenths = unit.parameter_raw(MAX_DISPLAY), unit.parameter_raw(RAMP_DOWN)
    if unit.reading is None or not span or tenths is None:
        return 0.0
    return unit.reading.commanded / span * tenths / 10
