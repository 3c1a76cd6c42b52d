"""A unit's setpoint before and after, as a review shows it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.commands.measure import measure_of_setpoint
from app.commands.review.ramp import Ramp, present_setpoint, ramp_of
from app.commands.review.risks import facts_of, obstacle_of, risks_of
from app.commands.rules.setpoint_range import setpoint_range
from app.commands.safeguards.limits import Limits
from app.commands.values import setpoint_message
from app.live.state.bus_live import BusLive, UnitLive
from bus.instants import UnixTime
from bus.messages import Message


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
    ramp: Ramp | None
    obstacle: Message | None
    risks: tuple[Message, ...]


def change_of(
    bus: BusLive, unit: UnitLive, new_raw: int, limits: Limits, now: UnixTime, *, block: Message | None = None
) -> SetpointChange:
    """What setting ``new_raw`` means for a unit. ``block``: why commands to it are blocked, if they are."""
    old_raw, allowed = present_setpoint(bus, unit), setpoint_range(unit, limits)
    ramp = ramp_of(unit, old_raw, new_raw)
    facts = facts_of(bus, unit, now, block=block, ramp=ramp, setpoint=new_raw)
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
        ramp=ramp,
        obstacle=obstacle_of(facts),
        risks=risks_of(facts),
    )
