"""How long a unit takes to ramp from one speed to another. Pure."""

from __future__ import annotations

from app.line.live.state.bus_live import UnitLive, follower
from bus.catalogue.numbers import ACCELERATION, DECELERATION, MAX_DISPLAY


def ramp_parameter(old: int | None, new: int) -> int:
    """The parameter that sets the ramp from one speed to another, raw: #7 downwards, else #6."""
    return DECELERATION if old is not None and new < old else ACCELERATION


def ramp_seconds(unit: UnitLive, old: int | None, new: int) -> float | None:
    """Seconds by #6 or #7, which are tenths for the full span #2. ``old``, ``new``: raw speeds. None for a
    follower, which comes with its master, and while a parameter is not known; a ramp of 0 is none."""
    span, tenths = unit.parameter_raw(MAX_DISPLAY), unit.parameter_raw(ramp_parameter(old, new))
    if old is None or tenths is None or follower(unit):
        return None
    if tenths == 0:
        return 0.0
    return abs(new - old) / span * tenths / 10 if span else None
