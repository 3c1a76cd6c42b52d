"""Whether a unit's setpoint may become what is asked. Pure.

In order: the range of the link and of a follower's ratio, the engineer's limits, how far it may move
within a minute, how large a step may be without a review. A master's speed 0 is always allowed: no
limit of ours may keep a line from being set to zero. A speed above #2 is the unit's to refuse.
"""

from __future__ import annotations

from app.commands.limits import HIGHEST_SETPOINT, Limits
from app.commands.objection import Circumstances, ObjectionError
from app.live.state import BusLive, UnitLive, follower

MAX_RATIO, MIN_RATIO = 31, 38


def check_setpoint(unit: int, raw: int, now: Circumstances) -> None:
    """Raises ObjectionError for the first reason why ``raw`` is not sent."""
    live = now.bus.units[unit]
    if raw == 0 and not follower(live):
        return
    limits = now.limits(unit)
    _check_bounds(live, raw, limits)
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


def bounds(live: UnitLive, limits: Limits) -> tuple[int, int, str]:
    """Lowest and highest setpoint, and who says so: the narrowest of all that is known."""
    lowest, highest, whose = 0, HIGHEST_SETPOINT, "what the link can carry"
    if follower(live):
        lowest = live.parameter_raw(MIN_RATIO) or 0
        most = live.parameter_raw(MAX_RATIO)
        highest = HIGHEST_SETPOINT if most is None else max(lowest, most)
        whose = f"its ratio limits, #{MIN_RATIO} and #{MAX_RATIO}"
    if limits.lowest is not None and limits.lowest > lowest:
        lowest, whose = limits.lowest, "the limits set for this unit"
    if limits.highest is not None and limits.highest < highest:
        highest, whose = limits.highest, "the limits set for this unit"
    return lowest, max(lowest, highest), whose


def _check_bounds(live: UnitLive, raw: int, limits: Limits) -> None:
    unit = live.settings.id
    lowest, highest, whose = bounds(live, limits)
    if lowest <= raw <= highest:
        return
    nearest = min(max(raw, lowest), highest)
    reason = f"unit {unit}: {raw} is outside {lowest} to {highest} ({whose}); the nearest is {nearest}"
    raise ObjectionError("invalid", reason, unit=unit, nearest=nearest)


def _check_rate(unit: int, step: int | None, limits: Limits, moved: int) -> None:
    if limits.per_minute is None or step is None:
        return
    left = max(0, limits.per_minute - moved)
    if step > left:
        allowed = f"the setpoint may move by {limits.per_minute} within a minute, of which {left} is left"
        raise ObjectionError("invalid", f"unit {unit}: {allowed}; this would move it by {step}", unit=unit)


def _check_step(unit: int, step: int | None, limits: Limits) -> None:
    largest = limits.largest_step
    if largest is None or (step is not None and step <= largest):
        return
    size = "of a size that cannot be known now" if step is None else f"of {step}"
    reason = f"unit {unit}: a step {size} needs a review, because the largest without one is {largest}"
    raise ObjectionError("confirm_needed", f"{reason}; confirm it", unit=unit)
