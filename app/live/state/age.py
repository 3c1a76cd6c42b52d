"""Whether values are live, stale or offline, from their age. Pure: the time is passed in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bus.contract import BusFigures, UnitLinkState
from bus.contract.durations import POLL_BYTES
from bus.instants import UnixTime
from bus.settings import BusSettings, wire_seconds

if TYPE_CHECKING:
    from app.live.state.bus_live import BusLive, UnitLive

OFFLINE_SCANS = 5
WORKER_TIMEOUT_S = 2.0
"""A worker reports its figures every second, beside the readings of its units."""


def stale_after_s(scan_s: float) -> float:
    """A response older than this is overdue: two seconds, or two scans where those take longer."""
    return max(2.0, 2 * scan_s)


def offline_after_s(scan_s: float) -> float:
    """No response for this long: the unit counts as lost."""
    return max(10.0, OFFLINE_SCANS * scan_s)


def scan_s_of(bus: BusLive) -> float:
    """How long one scan of all units takes: as the worker measured it, else what the wire allows."""
    if bus.figures is not None and bus.figures.scan_s > 0:
        return bus.figures.scan_s
    return scan_s_at_best(bus.settings)


def scan_s_at_best(settings: BusSettings) -> float:
    """The wire time of one poll of every configured unit, seconds."""
    return wire_seconds(len(settings.unit) * POLL_BYTES, settings.baud)


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
