"""What is not well on the line, the worst first, and the one sentence above it. Pure.

Three steps (ISA-18.2): *urgent* wants somebody now, *high* soon, *low* is to be known. One cause is
said once: while a port is closed its units are not listed one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from app.live.age import worker_is_silent
from app.live.fields import STATE_WORDS, Voice, bits_of, mode_of
from app.live.motion import State
from app.live.state import BusLive, UnitLive
from app.live.suspicion import suspicion
from bus.catalogue.status import StatusBits
from bus.contract import Reading, UnitLinkState

Level = Literal["urgent", "high", "low"]
LEVELS: tuple[Level, ...] = ("urgent", "high", "low")


@dataclass(frozen=True, slots=True)
class Trouble:
    """One thing that is not well. ``since``: when it began, seconds since the epoch; None: nobody saw it."""

    level: Level
    text: str
    code: str
    since: float | None = None


@dataclass(frozen=True, slots=True)
class Sight:
    """How a unit looks at this moment."""

    unit: UnitLive
    link: UnitLinkState
    state: State
    blocked: str = ""
    overdue: bool = True
    """A stale unit whose last answer is really old; one poll missed is shown, but is no trouble yet."""
    drifted: str = ""
    """In what it departs from what it ought to be, and who did that."""
    since: Mapping[str, float] = field(default_factory=dict)
    """When a condition of :func:`conditions_of` began."""


@dataclass(slots=True)
class Tally:
    """How many units are in which state."""

    units: int = 0
    heard: int = 0
    at_speed: int = 0
    at_zero: int = 0
    ramping: int = 0
    off_speed: int = 0

    def count(self, sight: Sight) -> None:
        """Take in one unit. A unit that is not heard is in no state."""
        self.units += 1
        if sight.link != "online":
            return
        self.heard += 1
        self.at_speed += sight.state == "at_speed"
        self.at_zero += sight.state == "at_zero"
        self.ramping += sight.state.startswith("ramping")
        self.off_speed += sight.state == "off_speed"


def bus_trouble(bus: BusLive, voice: Voice, now: float) -> Trouble | None:
    """What is wrong with a whole bus."""
    if not bus.worker_connected:
        return Trouble("urgent", voice.t("the bus worker is not connected"), "worker")
    if bus.figures is not None and worker_is_silent(bus, now):
        return Trouble("urgent", voice.t("the bus worker says nothing"), "worker", bus.figures.at)
    if bus.link.link == "closed":
        cause = f": {voice.t(bus.link.cause)}" if bus.link.cause else ""
        return Trouble("urgent", voice.t("the port is closed") + cause, "port", bus.link.at)
    return None


def conditions_of(bits: StatusBits, reading: Reading, state: State) -> frozenset[str]:
    """What of a reading is not well, by the codes of :class:`Trouble`."""
    found = (
        ("estop", bits.estop_active),
        ("off_speed", state == "off_speed"),
        ("mode", not bits.remote),
        ("run", reading.commanded > 0 and not bits.run),
    )
    return frozenset(code for code, holds in found if holds)


def unit_trouble(bus: BusLive, sight: Sight, voice: Voice) -> Trouble | None:
    """The worst that is wrong with one unit, as far as it is heard."""
    reading = sight.unit.reading
    if sight.link == "unknown" or reading is None:
        return Trouble("low", voice.t("no answer yet"), "unknown")
    if sight.link == "offline":
        return Trouble("high", voice.t("no answer"), "offline", reading.at)
    bits = bits_of(bus, reading)
    holding = conditions_of(bits, reading, sight.state)
    found = next(_findings(sight, suspicion(bus, sight.unit), holding, bits, voice), None)
    if found is None:
        return None
    level, text, code = found
    return Trouble(level, text, code, sight.since.get(code))


def _findings(
    sight: Sight, suspected: str, holding: frozenset[str], bits: StatusBits, voice: Voice
) -> Iterator[tuple[Level, str, str]]:
    """Level, words and code, the worst first; said only as far as somebody asks."""
    if "estop" in holding:
        yield "urgent", voice.t("e-stop input active"), "estop"
    if suspected:
        yield "high", voice.t(suspected), "suspect"
    if "off_speed" in holding:
        yield "high", voice.t(STATE_WORDS["off_speed"]), "off_speed"
    if sight.link == "stale" and sight.overdue:
        yield "low", voice.t("answer overdue"), "stale"
    if sight.blocked:
        yield "low", f"{voice.t('blocked')}: {sight.blocked}", "blocked"
    if "mode" in holding:
        yield _not_remote(mode_of(sight.unit, bits), voice)
    if "run" in holding:
        yield "low", voice.t("run input off"), "run"
    if sight.drifted:
        yield "low", sight.drifted, "drift"


def worst(troubles: list[Trouble]) -> Level | None:
    """The highest step among them."""
    return min((trouble.level for trouble in troubles), key=LEVELS.index, default=None)


def verdict(tally: Tally, abnormal: int, voice: Voice) -> str:
    """Is the line well? One sentence."""
    if tally.units == 0:
        return voice.t("No unit is configured")
    if abnormal and not tally.heard:
        return voice.t("No unit answers")
    if abnormal:
        text = "{n} needs a look" if abnormal == 1 else "{n} need a look"
        return voice.t(text, n=abnormal)
    if tally.at_zero == tally.units:
        return voice.t("All {n} units at zero", n=tally.units)
    if tally.ramping:
        return voice.t("{n} of {units} ramping", n=tally.ramping, units=tally.units)
    if tally.at_speed == tally.units:
        return voice.t("All {n} units at speed", n=tally.units)
    return voice.t("{n} of {units} at speed, the others at zero", n=tally.at_speed, units=tally.units)


def _not_remote(mode: str, voice: Voice) -> tuple[Level, str, str]:
    word = "KEYLOCK" if mode == "keylock" else "LOCAL"
    return "low", voice.t("{mode}: refuses", mode=word), "mode"
