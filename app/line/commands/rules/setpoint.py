"""The setpoints that a command would bring about, and whether a unit's may become the requested one. Pure:
the time is passed in.

In order: its range, how far it may move within a minute, how large a step may be without a review. A master's
speed 0 is always allowed: no limit here may keep a line from being set to zero.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from app.line.commands.rules.objection import RuleContext, objection
from app.line.commands.rules.setpoint_range import KIND_OF_PARAMETER, SetpointKind, kind_of, setpoint_range
from app.line.commands.safeguards.limits import Limits
from app.line.live.state.bus_live import BusLive, UnitLive, follower, setpoint_decimals
from bus.catalogue.numbers import DECIMALS
from bus.catalogue.values import ratio_text, speed_text
from bus.contract import WriteParameter
from bus.instants import Monotonic
from bus.messages import Message, number


@dataclass(frozen=True, slots=True)
class NewSetpoint:
    """``kind`` None: the unit's own. ``is_staged``: it changes nothing before it is executed."""

    unit: int
    raw: int
    kind: SetpointKind | None = None
    is_staged: bool = False


def staged_setpoints(bus: BusLive) -> dict[int, int]:
    """What each unit holds staged, raw, by unit."""
    return {number: unit.staged for number, unit in bus.units.items() if unit.staged is not None}


def of_write_parameter(action: WriteParameter, _: BusLive) -> list[NewSetpoint]:
    """The value, where a unit keeps a setpoint in this parameter."""
    kind = KIND_OF_PARAMETER.get(action.number)
    return [] if kind is None else [NewSetpoint(action.unit, action.raw, kind)]


def by_unit(setpoints: Mapping[int, int]) -> list[NewSetpoint]:
    """The setpoint of each unit, by its address."""
    return [NewSetpoint(unit, raw) for unit, raw in sorted(setpoints.items())]


def check_setpoint(unit: int, raw: int, now: RuleContext, kind: SetpointKind | None = None) -> None:
    """Raises Problem for the first reason why ``raw`` is not sent.

    ``kind``: of the setpoint where it is not the unit's own, which is judged by its range alone.
    """
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
    """The setpoint that the unit has now, to compare with a new one; None where it cannot be known."""
    if live.reading is None or (follower(live) and bus.settings.follower_speed == "speed"):
        return None
    return live.reading.commanded


def _check_scale(live: UnitLive, raw: int, limits: Limits) -> None:
    """Limits that were typed for another display are other limits by now; speed 0 needs none."""
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
    """A setpoint as the unit shows it; the bare integer while its decimals are not known."""
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
    """Steps of the last minute, by unit of one bus."""

    def __init__(self) -> None:
        self._steps: dict[int, deque[tuple[Monotonic, int]]] = {}

    def note(self, steps: Mapping[int, int], at: Monotonic) -> None:
        """The setpoint of each unit was moved by its step."""
        for unit, step in steps.items():
            self._steps.setdefault(unit, deque()).append((at, step))

    def take_back(self, steps: Mapping[int, int], at: Monotonic) -> None:
        """The steps noted for ``at`` did not happen."""
        for unit, step in steps.items():
            with suppress(ValueError):
                self._steps.get(unit, deque()).remove((at, step))

    def within_a_minute(self, unit: int, now: Monotonic) -> int:
        """The sum of all steps of the last minute."""
        steps = self._steps.get(unit)
        if steps is None:
            return 0
        while steps and steps[0][0] <= now - WINDOW_S:
            steps.popleft()
        return sum(step for _, step in steps)
