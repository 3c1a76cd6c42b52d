"""Why a unit is not at speed or cannot be commanded, as a code with parameters. Pure: the time is passed in.

The cause is the first broken rung of e-stop → run → mode → link → ramp: conditions that a unit needs to be at
speed, each of which needs the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal

from app.conditions.catalogue import CONDITIONS, ConditionCode
from app.conditions.priority import PRIORITIES, AlarmPriority
from app.live.state.age import offline_after_s, scan_s_of, stale_after_s, unit_link_now, worker_timed_out
from app.live.state.bus_live import BusLive, UnitLive, speed_decimals
from app.live.state.conditions import StatusCondition, bits_of, is_driven, mode_of
from app.live.state.onset import Onset, later
from app.live.state.ramp_time import ramp_seconds
from bus.contract import Reading, UnitLinkState
from bus.instants import UnixTime

Level = AlarmPriority | Literal[""]
"""The priority of its conditions. Empty: not abnormal."""
_CONDITION_OF: dict[str, ConditionCode] = {
    "worker_silent": "worker_lost",
    "address_suspect": "duplicate_address",
    "drift": "parameter_drift",
}
"""Of a cause that has another code."""


@dataclass(frozen=True, slots=True)
class UnitFacts:
    """One unit that was read, at one moment."""

    bus: BusLive
    unit: UnitLive
    reading: Reading
    link: UnitLinkState
    now: UnixTime

    def holds(self, name: StatusCondition) -> bool:
        return name in self.unit.onsets.of

    def since(self, *names: StatusCondition) -> Onset | None:
        return later(*(self.unit.onsets.of.get(name) for name in names))

    @property
    def is_late(self) -> bool:
        """Whether the last response is really old: one poll missed is shown, and is no cause yet."""
        age = self.now - self.reading.at
        return self.link == "stale" and age > stale_after_s(scan_s_of(self.bus))

    @property
    def stands(self) -> bool:
        return self.reading.commanded == 0 and self.reading.actual == 0


@dataclass(frozen=True, slots=True)
class Rung:
    """``conditions``: that hold while it is broken; none where that is not abnormal. ``since``: the status
    conditions that make it broken."""

    code: str
    is_broken: Callable[[UnitFacts], bool]
    conditions: Callable[[UnitFacts], Sequence[ConditionCode]]
    since: tuple[StatusCondition, ...] = ()
    params: Callable[[UnitFacts], Mapping[str, Any]] = lambda _: {}


def _motion(facts: UnitFacts) -> dict[str, str]:
    """How a unit moves that a broken rung holds back; nothing where that is not known or as commanded."""
    state = facts.unit.motion.state
    if is_driven(bits_of(facts.bus, facts.reading)):
        off_speed = "stopped" if facts.reading.actual == 0 else "off_speed"
        return {"motion": off_speed} if state == "off_speed" else {}
    if state in ("stopped", "at_zero"):
        return {"motion": "stopped"}
    return {"motion": state} if state in ("stopping", "turning") else {}


def _mode(facts: UnitFacts) -> dict[str, str]:
    return _motion(facts) | {"mode": mode_of(facts.unit, bits_of(facts.bus, facts.reading)).upper()}


def _ramp(facts: UnitFacts) -> dict[str, Any]:
    target = facts.reading.commanded
    seconds = ramp_seconds(facts.unit, facts.reading.actual, target)
    return {
        "target_raw": target,
        "decimals": speed_decimals(facts.bus, facts.unit),
        "seconds_left": None if seconds is None else ceil(seconds),
    }


RUNGS = (
    Rung(
        "estop_active",
        lambda f: f.holds("estop_active"),
        lambda _: ["estop_active"],
        ("estop_active",),
        _motion,
    ),
    Rung(
        "running_without_run",
        lambda f: f.unit.motion.state == "turning",
        lambda _: ["running_without_run"],
        ("run_off", "turning"),
    ),
    Rung(
        "run_off",
        lambda f: f.holds("run_off") and not f.stands,
        lambda f: ["run_off"] if f.reading.commanded else [],
        ("run_off",),
        _motion,
    ),
    Rung(
        "not_in_remote",
        lambda f: f.holds("not_in_remote"),
        lambda f: (
            ["not_in_remote", "not_at_speed"] if f.unit.motion.state == "off_speed" else ["not_in_remote"]
        ),
        ("not_in_remote",),
        _mode,
    ),
    Rung("link_stale", lambda f: f.is_late, lambda _: ["link_stale"]),
    Rung(
        "ramping",
        lambda f: f.unit.motion.state in ("ramping_up", "ramping_down"),
        lambda _: [],
        ("not_at_speed",),
        _ramp,
    ),
    Rung(
        "not_at_speed",
        lambda f: f.unit.motion.state == "off_speed",
        lambda _: ["not_at_speed"],
        ("not_at_speed",),
        _motion,
    ),
)
"""In the order in which each needs the one before."""


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause. ``params``: of its text; ``why`` among them is itself a text."""

    code: str
    level: Level
    onset: Onset | None = None
    params: Mapping[str, Any] = field(default_factory=dict)


def abnormal(code: str, onset: Onset | None = None, params: Mapping[str, Any] | None = None) -> Cause:
    """A cause with the priority of its condition. Raises KeyError for a code without one."""
    condition = _CONDITION_OF.get(code, code)
    return Cause(code, CONDITIONS[condition].priority, onset, params or {})  # type: ignore[index]


def level_of(conditions: Iterable[ConditionCode]) -> Level:
    """The highest priority of conditions that hold together; empty of none."""
    return min((CONDITIONS[code].priority for code in conditions), key=PRIORITIES.index, default="")


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
    facts = UnitFacts(bus, unit, reading, link, now)
    for rung in RUNGS:
        if rung.is_broken(facts):
            onset = facts.since(*rung.since) if rung.since else Onset(reading.at)
            return Cause(rung.code, level_of(rung.conditions(facts)), onset, rung.params(facts))
    return None


def _never_read(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause:
    """A unit that was there before a restart has its time to respond, then it is as lost as it was."""
    waited_s = now - bus.link_onset.at
    if unit.last_response is None or waited_s < offline_after_s(scan_s_of(bus)):
        return abnormal("unit_unknown")
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
