"""Why a unit is not at speed or cannot be commanded, as a code with parameters. Pure: the time is passed in.

The cause is the first broken rung of e-stop → run → mode → link → ramp: conditions that a unit needs to be at
speed, each of which needs the one before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal

from app.line.conditions.catalogue import TILES
from app.line.conditions.evidence import UnitFacts
from app.line.conditions.of_unit import BY_READING, UNIT_UNKNOWN
from app.line.conditions.priority import PRIORITIES, AlarmPriority
from app.line.live.diagnosis.links import unit_facts
from app.line.live.state.age import unit_link_now, worker_timed_out
from app.line.live.state.bus_live import BusLive, UnitLive, speed_decimals
from app.line.live.state.conditions import bits_of, is_driven, mode_of
from app.line.live.state.onset import Onset, later
from app.line.live.state.ramp_time import ramp_seconds
from app.line.live.state.scan_time import offline_after_s, scan_s_of, stale_after_s
from bus.contract import Reading
from bus.instants import UnixTime

Level = AlarmPriority | Literal[""]
"""The priority of its conditions. Empty: not abnormal."""


def _motion(bus: BusLive, unit: UnitLive, reading: Reading) -> dict[str, str]:
    """How a unit moves that a broken rung holds back; nothing where that is not known or as commanded."""
    state = unit.motion.state
    if is_driven(bits_of(bus, reading)):
        off_speed = "stopped" if reading.actual == 0 else "off_speed"
        return {"motion": off_speed} if state == "off_speed" else {}
    if state in ("stopped", "at_zero"):
        return {"motion": "stopped"}
    return {"motion": state} if state in ("stopping", "turning") else {}


def _mode(bus: BusLive, unit: UnitLive, reading: Reading) -> dict[str, str]:
    return {"mode": mode_of(unit, bits_of(bus, reading)).upper()}


_NAMED = {"motion": _motion, "mode": _mode}


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause. ``params``: of its text; ``why`` among them is itself a text."""

    code: str
    level: Level
    onset: Onset | None = None
    params: Mapping[str, Any] = field(default_factory=dict)


def abnormal(code: str, onset: Onset | None = None, params: Mapping[str, Any] | None = None) -> Cause:
    """A cause with the priority of its condition. Raises KeyError for a code without one."""
    return Cause(code, TILES[code].priority, onset, params or {})


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
        return abnormal("unit_offline", Onset(reading.at))
    # One poll missed is shown, and is no cause yet.
    is_late = link == "stale" and now - reading.at > stale_after_s(scan_s_of(bus))
    facts = unit_facts(bus, unit, reading, is_late=is_late)
    for index, row in enumerate(BY_READING):
        if (row.broken or row.holds)(facts):
            return _broken(index, facts, bus, unit, reading)
    return _ramp(bus, unit, reading) if unit.motion.state in ("ramping_up", "ramping_down") else None


def _broken(index: int, facts: UnitFacts, bus: BusLive, unit: UnitLive, reading: Reading) -> Cause:
    """The rung of a row of the ladder. It has the highest priority of what holds from there on."""
    row = BY_READING[index]
    held = [each.priority for each in BY_READING[index:] if each.holds(facts)] if row.holds(facts) else []
    params = {key: text for name in row.names for key, text in _NAMED[name](bus, unit, reading).items()}
    since = row.since or ((row.code,) if row.status else ())
    onset = _since(unit, since) if since else Onset(reading.at)
    return Cause(row.code, min(held, key=PRIORITIES.index, default=""), onset, params)


def broken_rung(cause: Cause | None) -> str:
    """The broken rung of a ``unit_cause`` with its priority, ``run high``; the rung alone where another
    condition has the priority; empty where no rung is broken. What cannot be read breaks the rung link."""
    if cause is None or cause.code == "ramping":
        return ""
    return f"{TILES[cause.code].rung or 'link'} {cause.level}".rstrip()


def _since(unit: UnitLive, names: Sequence[str]) -> Onset | None:
    return later(*(unit.onsets.of.get(name) for name in names))


def _ramp(bus: BusLive, unit: UnitLive, reading: Reading) -> Cause:
    target = reading.commanded
    seconds = None if target is None else ramp_seconds(unit, reading.actual, target)
    left = None if seconds is None else ceil(seconds)
    params = {
        "target_raw": target,
        "decimals": speed_decimals(bus, unit),
        "seconds_left": left,
    }
    return Cause("ramping", "", _since(unit, ("not_at_speed",)), params)


def _never_read(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause:
    """A unit without a response since the start has its time, then it is as lost as any other."""
    is_overdue = now - bus.link_onset.at >= offline_after_s(scan_s_of(bus))
    if UNIT_UNKNOWN.holds(is_overdue):
        return abnormal("unit_unknown")
    if unit.last_response is None:
        return abnormal("unit_offline", Onset(bus.link_onset.at, exact=False))
    return abnormal("unit_offline", Onset(unit.last_response))


def bus_cause(bus: BusLive, now: UnixTime) -> Cause | None:
    """Why no unit of a bus can be read."""
    if bus.worker_lost is not None:
        return abnormal("worker_lost", bus.worker_lost)
    if bus.figures is not None and worker_timed_out(bus, now):
        return abnormal("worker_silent", Onset(bus.figures.at))
    if bus.link.link == "closed":
        return abnormal("port_lost", bus.link_onset, {"why": bus.link.cause})
    return None
