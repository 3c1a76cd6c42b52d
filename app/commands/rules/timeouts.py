"""How long a command may take where its sender gives no timeout. Pure; seconds."""

from __future__ import annotations

from app.live.state.bus_live import BusLive
from app.web.deadline import DEFAULT_TIMEOUT_S
from bus.contract.durations import longest_stage_s


def timeout_s_for(bus: BusLive, staged_units: int = 0) -> float:
    """How long a write may wait to be sent: a change of several units needs the time of its staging too.
    ``staged_units``: how many, 0 for a command to one."""
    return DEFAULT_TIMEOUT_S + staged_units * longest_stage_s(bus.baud, bus.settings.turnaround_s)


def longest_change_s(bus: BusLive, units: int) -> float:
    """Until the result of a change of several units is known at the latest: it may be withdrawn from each."""
    return 2 * timeout_s_for(bus, units)
