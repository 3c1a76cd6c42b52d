"""What to do next on a bus of which no unit has responded yet. Pure."""

from __future__ import annotations

from typing import Literal

from app.line.live.state.bus_live import BusLive

FirstStep = Literal["worker", "port", "scan"]
"""The missing part: the bus worker, its port, or a unit that responds."""


def next_step(bus: BusLive) -> FirstStep | None:
    """Return the first missing part; None once a unit responds, or where one has responded before."""
    if any(unit.reading or unit.last_response for unit in bus.units.values()):
        return None
    if not bus.worker_connected:
        return "worker"
    return "scan" if bus.link.link == "open" else "port"
