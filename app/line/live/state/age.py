"""Whether values are live, stale or offline, from their age. Pure: the time is passed in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.line.live.state.scan_time import offline_after_s, scan_s_of, stale_after_s
from bus.contract import BusFigures, UnitLinkState
from bus.instants import UnixTime

if TYPE_CHECKING:
    from app.line.live.state.bus_live import BusLive, UnitLive

WORKER_TIMEOUT_S = 2.0
"""A worker reports its figures every second, beside the readings of its units."""


def unit_link_now(bus: BusLive, unit: UnitLive, now: UnixTime) -> UnitLinkState:
    """As the worker has it, made worse by the age of the reading and by a closed port."""
    if unit.reading is None:
        return "unknown"
    scan_s = scan_s_of(bus)
    if lost_at(bus, unit, now, offline_after_s(scan_s)) is not None:
        return "offline"
    age = now - unit.reading.at
    if unit.link.link != "online" or bus.link.link == "closed" or age > stale_after_s(scan_s):
        return "stale"
    return "online"


def lost_at(bus: BusLive, unit: UnitLive, now: UnixTime, patience_s: float) -> UnixTime | None:
    """When a unit was found not to respond for ``patience_s``; None: it was not.

    After a silence of the bus its units respond one after the other: each has its time again, but for one
    that was lost before.
    """
    if unit.reading is not None and unit.link.link == "offline":
        known_at = found_at = unit.link.at
    else:
        known_at = bus.link_onset.at if unit.reading is None else unit.reading.at
        found_at = known_at + patience_s
    if bus.silence is not None and known_at <= bus.silence.until and found_at > bus.silence.since:
        found_at = bus.silence.until + patience_s
    return found_at if now >= found_at else None


def worker_timed_out(bus: BusLive, now: UnixTime) -> bool:
    """Whether a connected worker has stopped sending: its process hangs, or its network is cut."""
    if not bus.worker_connected or bus.figures is None:
        return False
    since = now - WORKER_TIMEOUT_S
    return bus.figures.at < since and (bus.read_at is None or bus.read_at < since)


def figures_now(bus: BusLive, now: UnixTime) -> BusFigures | None:
    """The figures of a bus as far as they are of this moment."""
    return None if bus.link.link == "closed" or worker_timed_out(bus, now) else bus.figures
