"""Rules: whether a command may be sent, and which setpoints a unit may get. Pure: time is passed in.

==========  =======================================================================================
a speed     0 to #2, the number displayed at full scale. An engineer's own highest setpoint takes its
            place, and may be above it. Without either the protocol's limit holds (manual, 82h) and the
            unit decides: one without #2 (NAK 82h), or with 0 there, states no limit
a ratio     #38 to #31, which an engineer's own limits can only narrow
==========  =======================================================================================

A setpoint is checked in this order: its range, how far it may move within a minute, how large a step may be
without a review. A master's speed 0 is always allowed: no limit may keep a line from being set to zero. Only
the unit can decide on a write in LOCAL and on an analog output that is not set for the link: these are sent,
and refused by the unit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from app.errors import Problem
from app.line.commands.limits import HIGHEST_SETPOINT, CommandBlock, Limits
from app.line.live.bus_live import BusLive, UnitLive, bits_of, follower, setpoint_decimals
from bus.catalogue.parameters import (
    ANALOG_OUT_HIGH,
    ANALOG_OUT_LOW,
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
    MAX_RATIO,
    MIN_RATIO,
    PARAMETERS,
    RATIO_SETPOINT,
    SPEED_SETPOINT,
    IllegalValue,
    Parameter,
    check_writable_value,
)
from bus.catalogue.values import OUTPUT_NUMBERS, ratio_text, speed_text, status_bits
from bus.contract import ChangeBaud, SetLine, WriteAnalogOutput, WriteOutput, WriteParameter
from bus.errors import CallerError
from bus.instants import Monotonic
from bus.messages import Message, number
from bus.settings import BAUDS

Code = Literal["invalid", "dangerous", "confirm_needed", "blocked"]
_STATUS: dict[Code, int] = {"invalid": 422, "dangerous": 409, "confirm_needed": 409, "blocked": 423}


def objection(code: Code, reason: Message, *, unit: int | None = None, nearest: int | None = None) -> Problem:
    """Make the refusal of a command. ``nearest``: the closest value that would be accepted."""
    offered = {} if nearest is None else {"nearest": nearest}
    message = Message.of("nothing_sent", reason=reason)
    return Problem(_STATUS[code], code, message, outcome=code, unit=unit, **offered)


def reason_of(problem: Problem) -> Message:
    """Return why one of several commands was refused, without the words that nothing was sent."""
    reason = problem.message.params.get("reason")
    return reason if isinstance(reason, Message) else problem.message


@dataclass(frozen=True, slots=True)
class RuleContext:
    """The state on which the rules decide. ``moved``: how far a unit's setpoint has moved within a minute."""

    bus: BusLive
    limits: Callable[[int], Limits]
    block: Callable[[int], CommandBlock | None]
    moved: Callable[[int], int]
    confirm: bool = False


SetpointKind = Literal["speed", "ratio"]
Basis = Literal["protocol", "display", "ratio", "limits"]
"""The source of a limit: the protocol (82h), the maximum display value (#2), the limits of a ratio (#38 and
#31), or an engineer."""
KIND_OF_PARAMETER: dict[int, SetpointKind] = {SPEED_SETPOINT: "speed", RATIO_SETPOINT: "ratio"}
"""The parameters in which a unit keeps its setpoint."""
_DECIDING: dict[SetpointKind, tuple[int, ...]] = {
    "speed": (MAX_DISPLAY,),
    "ratio": (MAX_RATIO, MIN_RATIO),
}


@dataclass(frozen=True, slots=True)
class SetpointRange:
    """The setpoints that a unit accepts, raw, both ends included."""

    kind: SetpointKind
    lowest: int
    highest: int
    basis: Basis

    def allows(self, raw: int) -> bool:
        """Return whether a setpoint is inside. Speed 0 always is."""
        return self.lowest <= raw <= self.highest or (raw == 0 and self.kind == "speed")

    def nearest(self, raw: int) -> int:
        """Return the closest setpoint that is inside."""
        return min(max(raw, self.lowest), self.highest)


def kind_of(unit: UnitLive) -> SetpointKind:
    """Return the kind of the unit's own setpoint, by #8; a speed while #8 was not read."""
    return "ratio" if follower(unit) else "speed"


def setpoint_range(unit: UnitLive, limits: Limits, kind: SetpointKind | None = None) -> SetpointRange:
    """Return the range of a setpoint of the unit. ``kind``: that of a setpoint that is not the unit's own,
    since a master has a ratio in #37 too; the engineer's ``limits`` apply only to its own."""
    own = kind_of(unit)
    kind = kind or own
    found = _of_the_unit(unit, kind)
    return _narrowed(found, limits) if kind == own else found


def unread_for_range(
    unit: UnitLive, limits: Limits, raw: int, kind: SetpointKind | None = None
) -> tuple[int, ...]:
    """Return the parameters that must be read before it is known whether ``raw`` is inside the range."""
    kind = kind or kind_of(unit)
    if raw == 0 and kind == "speed":
        return ()
    replaced = kind == kind_of(unit) == "speed" and limits.highest is not None
    deciding = (FOLLOWER_MODE,) if replaced else (FOLLOWER_MODE, *_DECIDING[kind])
    return tuple(number for number in deciding if number not in unit.parameters)


def parameter_bounds(unit: UnitLive, number: int, limits: Limits) -> tuple[int, int]:
    """Return the lowest and highest raw value of a parameter: those in the manual, or the range of the
    setpoint that the unit keeps in it."""
    parameter, kind = PARAMETERS[number], KIND_OF_PARAMETER.get(number)
    if kind is None:
        return parameter.minimum, parameter.maximum
    found = setpoint_range(unit, limits, kind)
    return found.lowest, found.highest


def _of_the_unit(unit: UnitLive, kind: SetpointKind) -> SetpointRange:
    if kind == "speed":
        most = unit.parameter_raw(MAX_DISPLAY)
        return SetpointRange(
            kind, 0, _within_protocol(most or HIGHEST_SETPOINT), "display" if most else "protocol"
        )
    least, most = unit.parameter_raw(MIN_RATIO) or 0, unit.parameter_raw(MAX_RATIO)
    basis: Basis = "ratio" if least or most else "protocol"
    return SetpointRange(
        kind, _within_protocol(least), _within_protocol(max(least, most or HIGHEST_SETPOINT)), basis
    )


def _narrowed(found: SetpointRange, limits: Limits) -> SetpointRange:
    """Apply an engineer's limits to a range. A highest speed replaces #2; nothing else widens it."""
    lowest, highest = found.lowest, found.highest
    if limits.highest is not None:
        own = max(lowest, min(highest, limits.highest))
        highest = _within_protocol(limits.highest) if found.kind == "speed" else own
    if limits.lowest is not None:
        lowest = min(max(lowest, limits.lowest), highest)
    if (lowest, highest) == (found.lowest, found.highest):
        return found
    return SetpointRange(found.kind, lowest, highest, "limits")


def _within_protocol(raw: int) -> int:
    return min(raw, HIGHEST_SETPOINT)


@dataclass(frozen=True, slots=True)
class NewSetpoint:
    """A setpoint that a command would bring about. ``kind`` None: the unit's own. ``is_staged``: it changes
    nothing until it is executed."""

    unit: int
    raw: int
    kind: SetpointKind | None = None
    is_staged: bool = False


def staged_setpoints(bus: BusLive) -> dict[int, int]:
    """Return the raw setpoint that each unit holds staged, by unit."""
    return {number: unit.staged for number, unit in bus.units.items() if unit.staged is not None}


def setpoint_written(action: WriteParameter, _: BusLive) -> list[NewSetpoint]:
    """Return the value as a setpoint if the unit keeps one in this parameter."""
    kind = KIND_OF_PARAMETER.get(action.number)
    return [] if kind is None else [NewSetpoint(action.unit, action.raw, kind)]


def new_setpoints(setpoints: Mapping[int, int]) -> list[NewSetpoint]:
    """Return the setpoint of each unit, in the order of their addresses."""
    return [NewSetpoint(unit, raw) for unit, raw in sorted(setpoints.items())]


def check_setpoint(unit: int, raw: int, now: RuleContext, kind: SetpointKind | None = None) -> None:
    """Raise Problem for the first reason not to send ``raw``. ``kind``: that of a setpoint that is not the
    unit's own, which is judged by its range alone."""
    live, limits = now.bus.units[unit], now.limits(unit)
    _check_scale(live, raw, limits)
    _check_range(live, raw, limits, kind)
    if kind not in (None, kind_of(live)) or (raw == 0 and not follower(live)):
        return
    present = commanded_setpoint(live, now.bus)
    step = None if present is None else abs(raw - present)
    _check_rate(unit, step, limits, now.moved(unit))
    if not now.confirm:
        _check_step(unit, step, limits)


def commanded_setpoint(live: UnitLive, bus: BusLive) -> int | None:
    """Return the setpoint that the unit has now, to compare with a new one; None if it cannot be known."""
    if live.reading is None or (follower(live) and bus.settings.follower_speed == "speed"):
        return None
    return live.reading.commanded


def setpoint_parameter(live: UnitLive, bus: BusLive) -> int | None:
    """Return the parameter that holds the setpoint of the unit while its status shows another value: an input
    overrides the setpoint, or a follower shows its speed. None if the status shows the setpoint."""
    if live.reading is None:
        return None
    bits = bits_of(bus, live.reading)
    follows, is_overridden = follower(live) or bits.follower, bits.preset or bits.up or bits.down
    if follows:
        return RATIO_SETPOINT if is_overridden or bus.settings.follower_speed == "speed" else None
    return SPEED_SETPOINT if is_overridden else None


def _check_scale(live: UnitLive, raw: int, limits: Limits) -> None:
    """Refuse limits that were typed for another display and so mean other speeds now. Speed 0 needs none."""
    are_other = limits.are_set and limits.decimals not in (None, setpoint_decimals(live))
    if are_other and (raw or follower(live)):
        unit = live.settings.id
        raise objection("invalid", Message.of("limits_of_other_scale", unit=unit), unit=unit)


def _check_range(live: UnitLive, raw: int, limits: Limits, kind: SetpointKind | None) -> None:
    allowed = setpoint_range(live, limits, kind)
    if allowed.allows(raw):
        return
    unit, nearest = live.settings.id, allowed.nearest(raw)
    numbers = {"value": raw, "lowest": allowed.lowest, "highest": allowed.highest, "nearest": nearest}
    shown = {name: number(setpoint_text(live, raw, allowed.kind)) for name, raw in numbers.items()}
    reason = Message.of(f"setpoint_outside_{allowed.basis}", unit=unit, **shown)
    raise objection("invalid", reason, unit=unit, nearest=nearest)


def setpoint_text(live: UnitLive, raw: int, kind: SetpointKind) -> str:
    """Return a setpoint as the unit shows it; the bare integer while its decimals are not known."""
    sign, size = ("-" if raw < 0 else ""), abs(raw)
    if kind == "ratio":
        return sign + ratio_text(size)
    decimals = live.parameter_raw(DECIMALS)
    return sign + (str(size) if decimals is None else speed_text(size, decimals))


def _check_rate(unit: int, step: int | None, limits: Limits, moved: int) -> None:
    if limits.per_minute is None or step is None:
        return
    left = max(0, limits.per_minute - moved)
    if step > left:
        reason = Message.of("moves_too_far", unit=unit, most=limits.per_minute, left=left, step=step)
        raise objection("invalid", reason, unit=unit)


def _check_step(unit: int, step: int | None, limits: Limits) -> None:
    largest = limits.largest_step
    if largest is None or (step is not None and step <= largest):
        return
    if step is None:
        reason = Message.of("unknown_step_needs_review", unit=unit, largest=largest)
    else:
        reason = Message.of("step_needs_review", unit=unit, size=step, largest=largest)
    raise objection("confirm_needed", reason, unit=unit)


WINDOW_S = 60.0


class Moves:
    """The distances by which the setpoints of one bus have moved within the last minute."""

    def __init__(self) -> None:
        self._steps: dict[int, deque[tuple[Monotonic, int]]] = {}

    def note(self, steps: Mapping[int, int], at: Monotonic) -> None:
        """Note that the setpoint of each unit moves by its step."""
        for unit, step in steps.items():
            self._steps.setdefault(unit, deque()).append((at, step))

    def take_back(self, steps: Mapping[int, int], at: Monotonic) -> None:
        """Forget the steps noted for ``at``, which did not happen."""
        for unit, step in steps.items():
            with suppress(ValueError):
                self._steps.get(unit, deque()).remove((at, step))

    def within_a_minute(self, unit: int, now: Monotonic) -> int:
        """Return the sum of the unit's steps of the last minute."""
        steps = self._steps.get(unit)
        if steps is None:
            return 0
        while steps and steps[0][0] <= now - WINDOW_S:
            steps.popleft()
        return sum(step for _, step in steps)


def slows_all(setpoints: Mapping[int, int], bus: BusLive) -> bool:
    """Return whether each of these units becomes slower or stops, compared with its last reading. A setpoint
    never changes the direction."""
    return all(_slows(bus.units[unit], raw, bus) for unit, raw in setpoints.items())


def _slows(unit: UnitLive, raw: int, bus: BusLive) -> bool:
    """Return whether a unit becomes slower. A follower never counts: a lower ratio slows one section against
    the others, and the web between them goes slack or tears. Its master makes it slower."""
    if follower(unit):
        return False
    if raw == 0:
        return True
    present = commanded_setpoint(unit, bus)
    return unit.link.link == "online" and present is not None and raw < present


def check_line(action: SetLine, _: RuleContext) -> None:
    """Raise the refusal of a change without units."""
    if not action.setpoints:
        raise objection("invalid", Message("setpoints_missing"))


def check_output(action: WriteOutput, _: RuleContext) -> None:
    """Raise the refusal of an output that no unit has."""
    if action.number not in OUTPUT_NUMBERS:
        raise objection("invalid", Message("no_such_output"), unit=action.unit)


def check_analog_output(action: WriteAnalogOutput, now: RuleContext) -> None:
    """Refuse a value outside #29 to #30, as far as these are known."""
    live = now.bus.units[action.unit]
    low, high = live.parameter_raw(ANALOG_OUT_LOW), live.parameter_raw(ANALOG_OUT_HIGH)
    lowest = 0 if low is None else low
    highest = HIGHEST_SETPOINT if high is None else max(lowest, high)
    if lowest <= action.raw <= highest:
        return
    nearest = min(max(action.raw, lowest), highest)
    raise objection(
        "invalid",
        Message.of(
            "analog_output_outside", unit=action.unit, lowest=lowest, highest=highest, nearest=nearest
        ),
        unit=action.unit,
        nearest=nearest,
    )


def check_parameter(action: WriteParameter, now: RuleContext) -> None:
    """Refuse a value outside the range and choices of the manual's parameter list, and a write that the unit
    does not accept while it runs."""
    parameter = PARAMETERS.get(action.number)
    if parameter is None:
        raise objection("invalid", Message("no_such_parameter"), unit=action.unit)
    _check_value(parameter, action)
    if parameter.not_while_running and _is_running(now.bus.units[action.unit], now.bus):
        reason = Message.of("parameter_not_while_running", number=parameter.number, called=parameter.name)
        raise objection("invalid", reason, unit=action.unit)


def _check_value(parameter: Parameter, action: WriteParameter) -> None:
    try:
        check_writable_value(parameter, action.raw)
    except CallerError as error:
        nearest = error.nearest if isinstance(error, IllegalValue) else None
        raise objection("invalid", error.message, unit=action.unit, nearest=nearest) from error


def check_baud(action: ChangeBaud, _: RuleContext) -> None:
    """Refuse a baud rate that #18 does not have."""
    if action.baud not in BAUDS:
        nearest = min(BAUDS, key=lambda baud: abs(baud - action.baud))
        raise objection(
            "invalid", Message.of("baud_unknown", rates=", ".join(map(str, BAUDS))), nearest=nearest
        )


def _is_running(live: UnitLive, bus: BusLive) -> bool:
    reading = live.reading
    if reading is None:
        return False
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy).run
