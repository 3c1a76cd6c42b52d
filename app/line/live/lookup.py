"""What a request names, or the refusal in words."""

from __future__ import annotations

from app.core.web.services import unknown_bus, unknown_unit
from app.line.live.state.bus_live import BusLive, LiveState, UnitLive


def bus_or_404(live: LiveState, bus: str) -> BusLive:
    """A configured bus. Raises Problem 404."""
    found = live.buses.get(bus)
    if found is None:
        raise unknown_bus(bus, live.buses)
    return found


def unit_or_404(live: LiveState, bus: str, unit: int) -> UnitLive:
    """A configured unit. Raises Problem 404."""
    return unit_of_bus_or_404(bus_or_404(live, bus), unit)


def unit_of_bus_or_404(bus: BusLive, unit: int) -> UnitLive:
    """A configured unit of this bus. Raises Problem 404."""
    found = bus.units.get(unit)
    if found is None:
        raise unknown_unit(bus.settings.name, unit)
    return found
