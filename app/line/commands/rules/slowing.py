"""Whether a command can only make units slower, or stop them. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from app.line.commands.rules.setpoint import commanded_setpoint
from app.line.live.state.bus_live import BusLive, UnitLive, follower


def slows_all(setpoints: Mapping[int, int], bus: BusLive) -> bool:
    """Whether each of these units becomes slower, as it was last read. The direction of a unit is none of a
    setpoint's: it stays."""
    return all(_slows(bus.units[unit], raw, bus) for unit, raw in setpoints.items())


def _slows(unit: UnitLive, raw: int, bus: BusLive) -> bool:
    """A follower's ratio never counts: lower, it slows one section against the others, and the web between
    them goes slack or tears. Its master makes it slower."""
    if follower(unit):
        return False
    if raw == 0:
        return True
    present = commanded_setpoint(unit, bus)
    return unit.link.link == "online" and present is not None and raw < present
