"""Whether values are live, stale or offline, from their age. Pure: the time is passed in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.live.state.scan_time import offline_after_s, scan_s_of, stale_after_s
from bus.contract import BusFigures, UnitLinkState
from bus.instants import UnixTime

if TYPE_CHECKING:
    from app.live.state.bus_live import BusLive, UnitLive

WORKER_TIMEOUT_S = 2.0
"""A worker reports its figures every second, beside the readings of its units."""


def unit_link_now(bus: BusLive, unit: UnitLive, now: UnixTime) -> UnitLinkState:
    """The worker's opinion, made worse by the age of the reading and by a closed port, never better."""
    if unit.reading is None:
        return "unknown"
    link = unit.link.link
    if link == "offline":
        return "offline"
    age = now - unit.reading.at
    scan_s = scan_s_of(bus)
    if age > offline_after_s(scan_s):
        return "offline"
    if link != "online" or bus.link.link == "closed" or age > stale_after_s(scan_s):
        return "stale"
    return "online"


def worker_timed_out(bus: BusLive, now: UnixTime) -> bool:
    """Whether a connected worker has stopped sending: its process hangs, or its network is cut."""
    if not bus.worker_connected or bus.figures is None:
        return False
    since = now - WORKER_TIMEOUT_S
    return bus.figures.at < since and (bus.read_at is None or bus.read_at < since)


def figures_now(bus: BusLive, now: UnixTime) -> BusFigures | None:
    """The figures of a bus as far as they are of this moment."""
    return None if bus.link.link == "closed" or worker_timed_out(bus, now) else bus.figures
