"""What a request names, or the refusal in words."""

from __future__ import annotations

from app.errors import Problem
from app.live.state import BusLive, LiveState, UnitLive


def bus_or_404(live: LiveState, bus: str) -> BusLive:
    """A configured bus. Raises Problem 404."""
    found = live.buses.get(bus)
    if found is None:
        known = ", ".join(live.buses) or "none"
        raise Problem(404, "unknown_bus", f"there is no bus {bus!r}; there are: {known}")
    return found


def unit_or_404(live: LiveState, bus: str, unit: int) -> UnitLive:
    """A configured unit. Raises Problem 404."""
    found = bus_or_404(live, bus).units.get(unit)
    if found is None:
        raise Problem(404, "unknown_unit", f"bus {bus!r} has no unit {unit} in lineside.toml", unit=unit)
    return found
