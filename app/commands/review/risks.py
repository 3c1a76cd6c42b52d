"""What a review shows of a unit: its setpoint before and after, why it cannot take a command now, and risks.
Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from app.commands.review.ramp import Ramp, present_setpoint, ramp_of
from app.commands.rules.setpoint_range import KIND_OF_PARAMETER, is_above_display, setpoint_range
from app.commands.safeguards.limits import Limits
from app.commands.values import measure_of_setpoint, setpoint_message
from app.live.state.age import unit_link_now
from app.live.state.bus_live import BusLive, UnitLive
from app.live.state.conditions import bits_of
from bus.catalogue.numbers import ACCELERATION, DECELERATION
from bus.instants import UnixTime
from bus.messages import Message


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
    return tuple(_risks(bus, unit, now, ramp, setpoint))


def _risks(
    bus: BusLive, unit: UnitLive, now: UnixTime, ramp: Ramp | None, setpoint: int | None
) -> Iterator[Message]:
    if setpoint is not None and is_above_display(unit, setpoint):
        yield Message("risk_above_display")
    if unit.reading is not None:
        if unit_link_now(bus, unit, now) == "stale":
            yield Message.of("risk_stale", age=round(max(0.0, now - unit.reading.at)))
        bits = bits_of(bus, unit.reading)
        if bits.estop_active:
            yield Message("risk_estop_active")
        if not bits.run:
            yield Message("risk_run_off")
    if ramp is not None and ramp.tenths == 0:
        yield Message.of("risk_no_ramp", number=ramp.number)
    if ramp is not None and ramp.seconds is None:
        yield Message("risk_ramp_unknown")


def risks_of_writing(number: int, raw: int) -> tuple[Message, ...]:
    if number in (ACCELERATION, DECELERATION) and raw == 0:
        return (Message.of("risk_no_ramp", number=number),)
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
    ramp: Ramp | None
    obstacle: Message | None
    risks: tuple[Message, ...]


def change_of(
    bus: BusLive, unit: UnitLive, new_raw: int, limits: Limits, now: UnixTime, *, block: Message | None = None
) -> SetpointChange:
    """What setting ``new_raw`` means for a unit. ``block``: why commands to it are blocked, if they are."""
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
        ramp=ramp,
        obstacle=obstacle_of(bus, unit, now, block=block),
        risks=risks_of(bus, unit, now, ramp, new_raw),
    )
