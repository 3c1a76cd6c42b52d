"""How long a scan of a bus takes, and how old a reading may become by it. Pure."""

from __future__ import annotations

from app.line.conditions.evidence import BusValues
from bus.contract.durations import POLL_BYTES
from bus.settings import BusSettings, wire_seconds

OFFLINE_SCANS = 5


def stale_after_s(scan_s: float) -> float:
    """A response older than this is overdue: two seconds, or two scans where those take longer."""
    return max(2.0, 2 * scan_s)


def offline_after_s(scan_s: float) -> float:
    """No response for this long: the unit counts as lost."""
    return max(10.0, OFFLINE_SCANS * scan_s)


def silence_after_s(scan_s: float) -> float:
    """No response of any unit for this long is a silence of the bus. It is shorter than the time of a unit by
    more than a scan, so that a time which loses a unit is one."""
    return offline_after_s(scan_s) / 2


def scan_s_of(bus: BusValues) -> float:
    """How long one scan of all units takes: as the worker measured it, else what the wire allows."""
    if bus.figures is not None and bus.figures.scan_s > 0:
        return bus.figures.scan_s
    return scan_s_at_best(bus.settings)


def scan_s_at_best(settings: BusSettings) -> float:
    """The wire time of one poll of every configured unit, seconds."""
    return wire_seconds(len(settings.unit) * POLL_BYTES, settings.baud)
