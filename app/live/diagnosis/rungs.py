"""What a unit needs to be at speed, as rungs: each needs the one before. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any, Literal

from app.live.state.age import scan_s_of, stale_after_s
from app.live.state.bus_live import BusLive, UnitLive, speed_decimals
from app.live.state.conditions import Condition, bits_of, is_driven, mode_of
from app.live.state.onset import Onset, later
from app.live.state.ramp_time import ramp_seconds
from bus.contract import Reading, UnitLinkState
from bus.instants import UnixTime

Level = Literal["", "urgent", "high", "low"]
"""How soon it needs a person (ISA-18.2, priority). Empty: not abnormal."""


@dataclass(frozen=True, slots=True)
class UnitFacts:
    """One unit that was read, at one moment."""

    bus: BusLive
    unit: UnitLive
    reading: Reading
    link: UnitLinkState
    now: UnixTime

    def holds(self, name: Condition) -> bool:
        return name in self.unit.onsets.of

    def since(self, *names: Condition) -> Onset | None:
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
    """``since``: the conditions that make it broken."""

    code: str
    is_broken: Callable[[UnitFacts], bool]
    level: Callable[[UnitFacts], Level]
    since: tuple[Condition, ...] = ()
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
    Rung("estop_active", lambda f: f.holds("estop_active"), lambda _: "urgent", ("estop_active",), _motion),
    Rung(
        "running_without_run",
        lambda f: f.unit.motion.state == "turning",
        lambda _: "high",
        ("run_off", "turning"),
    ),
    Rung(
        "run_off",
        lambda f: f.holds("run_off") and not f.stands,
        lambda f: "high" if f.reading.commanded else "",
        ("run_off",),
        _motion,
    ),
    Rung(
        "not_in_remote",
        lambda f: f.holds("not_in_remote"),
        lambda f: "high" if f.unit.motion.state == "off_speed" else "low",
        ("not_in_remote",),
        _mode,
    ),
    Rung("link_stale", lambda f: f.is_late, lambda _: "low"),
    Rung(
        "ramping",
        lambda f: f.unit.motion.state in ("ramping_up", "ramping_down"),
        lambda _: "",
        ("not_at_speed",),
        _ramp,
    ),
    Rung(
        "not_at_speed",
        lambda f: f.unit.motion.state == "off_speed",
        lambda _: "high",
        ("not_at_speed",),
        _motion,
    ),
)
"""In the order in which each needs the one before."""
