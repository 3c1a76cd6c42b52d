"""Setting a complete line to zero: which units take part, and which cannot. Pure.

It commands speed 0 and every unit ramps by its own #7. It is no emergency stop: nothing on this link
can run or stop a drive. Followers keep their ratio and come down with their master.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from app.commands.review.ramp import present_setpoint, ramp_of
from app.commands.review.risks import obstacle_of, risks_of
from app.live.state.bus_live import BusLive, follower
from bus.instants import UnixTime
from bus.messages import Message


@dataclass(slots=True)
class ZeroPlan:
    """For one bus. ``units``: address → name. ``left_out`` and ``risks``: name, with its reason or risk."""

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
