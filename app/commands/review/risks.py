"""What a review shows of a unit: its setpoint before and after, why it cannot take a command now, and risks.
Pure.

Obstacles and risks are tables in order of display. Only the first obstacle is shown: the next may disappear
with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from app.commands.review.ramp import Ramp, present_setpoint, ramp_of
from app.commands.rules.setpoint_range import KIND_OF_PARAMETER, is_above_display, setpoint_range
from app.commands.safeguards.limits import Limits
from app.commands.values import measure_of_setpoint, setpoint_message
from app.live.state.age import unit_link_now
from app.live.state.bus_live import BusLive, UnitLive
from app.live.state.conditions import bits_of
from bus.catalogue.numbers import ACCELERATION, DECELERATION
from bus.catalogue.status import StatusBits
from bus.contract import UnitLinkState
from bus.instants import UnixTime
from bus.messages import Message, ParamValue


@dataclass(frozen=True, slots=True)
class RiskInputs:
    """State of one unit at a moment. ``bits`` None: it has never responded. ``ramp`` None: the
    command starts none. ``block``: why commands to it are blocked, None where they are not.
    ``above_display``: an engineer's limit allows the setpoint, and #2 does not."""

    bus_is_open: bool
    link: UnitLinkState
    age_s: float
    bits: StatusBits | None
    block: Message | None
    ramp: Ramp | None
    above_display: bool

    @property
    def params(self) -> dict[str, ParamValue]:
        """What the messages below may name."""
        number = 0 if self.ramp is None else self.ramp.number
        return {"age": round(self.age_s), "block": self.block or "", "number": number}


@dataclass(frozen=True, slots=True)
class _Rule:
    code: str
    holds: Callable[[RiskInputs], bool]
    names: tuple[str, ...] = ()


_OBSTACLES = (
    _Rule("obstacle_blocked", lambda unit: bool(unit.block), ("block",)),
    _Rule("obstacle_no_link", lambda unit: not unit.bus_is_open),
    _Rule("obstacle_offline", lambda unit: unit.bits is None or unit.link == "offline"),
    _Rule("obstacle_not_in_remote", lambda unit: unit.bits is not None and not unit.bits.remote),
)
_RISKS = (
    _Rule("risk_above_display", lambda unit: unit.above_display),
    _Rule("risk_stale", lambda unit: unit.link == "stale", ("age",)),
    _Rule("risk_estop_active", lambda unit: unit.bits is not None and unit.bits.estop_active),
    _Rule("risk_run_off", lambda unit: unit.bits is not None and not unit.bits.run),
    _Rule("risk_no_ramp", lambda unit: unit.ramp is not None and unit.ramp.tenths == 0, ("number",)),
    _Rule("risk_ramp_unknown", lambda unit: unit.ramp is not None and unit.ramp.seconds is None),
)


def risks_of_writing(number: int, raw: int) -> tuple[Message, ...]:
    if number in (ACCELERATION, DECELERATION) and raw == 0:
        return (Message.of("risk_no_ramp", number=number),)
    if number in KIND_OF_PARAMETER:
        return (Message("risk_is_setpoint"),)
    return ()


def facts_of(
    bus: BusLive,
    unit: UnitLive,
    now: UnixTime,
    *,
    block: Message | None = None,
    ramp: Ramp | None = None,
    setpoint: int | None = None,
) -> RiskInputs:
    """``now``: seconds since the epoch. ``setpoint``: the new one, raw, where there is one."""
    reading = unit.reading
    return RiskInputs(
        bus_is_open=bus.link.link == "open",
        link=unit_link_now(bus, unit, now),
        age_s=0.0 if reading is None else max(0.0, now - reading.at),
        bits=None if reading is None else bits_of(bus, reading),
        block=block,
        ramp=ramp,
        above_display=setpoint is not None and is_above_display(unit, setpoint),
    )


def obstacle_of(facts: RiskInputs) -> Message | None:
    """Why the unit cannot take a command now; None where nothing is known against it."""
    return next(_remarks(_OBSTACLES, facts), None)


def risks_of(facts: RiskInputs) -> tuple[Message, ...]:
    """Risks that come from the unit's state."""
    return tuple(_remarks(_RISKS, facts))


def by_remark(remarks: Iterable[tuple[str, Message]]) -> list[tuple[Message, list[str]]]:
    """Each remark once, with the names of the units that it is about, in order."""
    found: dict[Message, list[str]] = {}
    for name, remark in remarks:
        found.setdefault(remark, []).append(name)
    return list(found.items())


def _remarks(rules: Iterable[_Rule], facts: RiskInputs) -> Iterator[Message]:
    params = facts.params
    for rule in rules:
        if rule.holds(facts):
            yield Message(rule.code, {name: params[name] for name in rule.names})


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
