"""Why a unit is not at speed or cannot be commanded: the first broken rung of
e-stop → run → mode → link → ramp, as a code with parameters. Pure: the time is passed in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from app.live.diagnosis.rungs import RUNGS, Level, UnitFacts
from app.live.state.age import offline_after_s, scan_s_of, unit_link_now, worker_timed_out
from app.live.state.bus_live import BusLive, UnitLive
from app.live.state.onset import Onset
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause. ``params``: of its text; ``why`` among them is itself a text."""

    code: str
    level: Level
    onset: Onset | None = None
    params: Mapping[str, Any] = field(default_factory=dict)


def unit_cause(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause | None:
    """The first broken rung of a unit; None: at speed or at a commanded zero, and open to commands.

    Of a unit that does not respond nothing is known but that. Where its bus is the cause, that is named, and
    is abnormal only once, at the bus.
    """
    link, reading = unit_link_now(bus, unit, now), unit.reading
    if link != "online" and (found := bus_cause(bus, now)) is not None:
        return Cause(found.code, "", found.onset, found.params)
    if reading is None:
        return _never_read(bus, unit, now)
    if link == "offline":
        return Cause("unit_offline", "high", Onset(reading.at))
    facts = UnitFacts(bus, unit, reading, link, now)
    for rung in RUNGS:
        if rung.is_broken(facts):
            onset = facts.since(*rung.since) if rung.since else Onset(reading.at)
            return Cause(rung.code, rung.level(facts), onset, rung.params(facts))
    return None


def _never_read(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause:
    """A unit that was there before a restart has its time to respond, then it is as lost as it was."""
    waited_s = now - bus.link_onset.at
    if unit.last_response is None or waited_s < offline_after_s(scan_s_of(bus)):
        return Cause("unit_unknown", "low")
    return Cause("unit_offline", "high", Onset(unit.last_response))


def bus_cause(bus: BusLive, now: UnixTime) -> Cause | None:
    """Why no unit of a bus can be read."""
    if bus.worker_lost is not None:
        return Cause("worker_lost", "urgent", bus.worker_lost)
    if bus.figures is not None and worker_timed_out(bus, now):
        return Cause("worker_silent", "urgent", Onset(bus.figures.at))
    if bus.link.link == "closed":
        return Cause("port_lost", "urgent", bus.link_onset, {"why": bus.link.cause})
    return None
