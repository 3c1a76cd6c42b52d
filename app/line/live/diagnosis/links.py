"""The facts by which conditions are judged: of a bus, of the link of a unit, and of its reading. Pure."""

from __future__ import annotations

from app.line.conditions.evidence import BusFacts, LinkFacts, UnitFacts
from app.line.live.state.age import lost_at, unit_link_now, worker_timed_out
from app.line.live.state.bus_live import BusLive, UnitLive
from app.line.live.state.conditions import bits_of
from app.line.live.state.scan_time import offline_after_s, scan_s_of
from bus.contract import Reading
from bus.contract.durations import POLL_BYTES
from bus.instants import UnixTime
from bus.settings import wire_seconds


def bus_facts(bus: BusLive, now: UnixTime) -> BusFacts:
    """Of a bus."""
    patience_s = offline_after_s(scan_s_of(bus))
    lost = unread = 0
    for unit in bus.units.values():
        if lost_at(bus, unit, now, patience_s) is not None:
            lost += 1
        elif unit.reading is None:
            unread += 1
    turnaround_s = wire_seconds(POLL_BYTES, bus.baud) + bus.settings.turnaround_s
    return BusFacts(
        worker_is_lost=bus.worker_lost is not None or worker_timed_out(bus, now),
        port_is_closed=bus.link.link == "closed",
        units=len(bus.units),
        lost=lost,
        unread=unread,
        scan_s=None if bus.figures is None else bus.figures.scan_s,
        longest_scan_s=len(bus.units) * turnaround_s,
    )


def any_responds(bus: BusLive, now: UnixTime) -> bool:
    """Whether any unit of a bus responds; the first one that does is enough."""
    patience_s = offline_after_s(scan_s_of(bus))
    return any(
        unit.reading is not None and lost_at(bus, unit, now, patience_s) is None
        for unit in bus.units.values()
    )


def link_facts(bus: BusLive, unit: UnitLive, now: UnixTime, *, bus_is_readable: bool) -> LinkFacts:
    """Of a unit."""
    found_at = lost_at(bus, unit, now, offline_after_s(scan_s_of(bus)))
    return LinkFacts(
        bus_is_readable=bus_is_readable,
        is_lost=found_at is not None,
        is_online=unit_link_now(bus, unit, now) == "online",
        is_alone=found_at is not None and len(bus.units) > 1 and not _has_reading_after(bus, found_at),
    )


def unit_facts(bus: BusLive, unit: UnitLive, reading: Reading, *, is_late: bool = False) -> UnitFacts:
    """Of a unit by its newest reading."""
    bits = bits_of(bus, reading)
    return UnitFacts(bits, unit.motion.state, reading.commanded, reading.actual, is_late)


def _has_reading_after(bus: BusLive, at: UnixTime) -> bool:
    return bus.read_at is not None and bus.read_at > at
