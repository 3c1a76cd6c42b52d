"""One bus and its units as they are now: the newest word of each, and what follows from a reading."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.live.state.age import offline_after_s, scan_s_of
from app.live.state.conditions import bits_of, conditions_of
from app.live.state.motion import Motion
from app.live.state.onset import Onset, Onsets
from bus.catalogue.numbers import DECIMALS, FOLLOWER_MODE
from bus.catalogue.values import MOST_DECIMALS, RATIO_DECIMALS, is_follower
from bus.contract import BusFigures, BusLink, ParameterValue, Reading, UnitLink
from bus.messages import Message
from bus.settings import BusSettings, UnitSettings


@dataclass(slots=True)
class UnitLive:
    """The newest word of one unit. ``link`` is the worker's opinion; the age has a say too."""

    settings: UnitSettings
    link: UnitLink
    reading: Reading | None = None
    parameters: dict[int, ParameterValue] = field(default_factory=dict)
    staged: int | None = None
    motion: Motion = field(default_factory=Motion)
    onsets: Onsets = field(default_factory=Onsets)
    last_response: float | None = None
    """Unix time, before this server started; None while it is not known."""

    def parameter_raw(self, number: int) -> int | None:
        """The raw value of a parameter as last read; None when never read or not available, and for decimals
        (#3) that no value can have."""
        known = self.parameters.get(number)
        raw = known.raw if known is not None else None
        return None if raw is not None and number == DECIMALS and raw > MOST_DECIMALS else raw


@dataclass(slots=True)
class BusLive:
    """One bus: its port as the worker sees it, its figures, its units in floor order."""

    settings: BusSettings
    link: BusLink
    link_onset: Onset
    """Since when the port is as ``link`` says."""
    worker_lost: Onset | None
    """Since when no worker is connected; None while one is."""
    worker_software: str = ""
    figures: BusFigures | None = None
    units: dict[int, UnitLive] = field(default_factory=dict)

    @property
    def worker_connected(self) -> bool:
        """Whether a worker speaks for this bus now."""
        return self.worker_lost is None

    @property
    def baud(self) -> int:
        """The present rate: what the worker says, as #18 may have moved it; else as configured."""
        return self.link.baud or self.settings.baud

    def take_link(self, link: BusLink) -> None:
        """Take in how the port is. A worker says it when it changes."""
        if link.link != self.link.link:
            self.link_onset = Onset(link.at)
        self.link = link

    def take_reading(self, unit: UnitLive, reading: Reading) -> None:
        """Take in what a unit of this bus reads, with all that follows from it."""
        unit.reading = reading
        bits, scan_s = bits_of(self, reading), scan_s_of(self)
        unit.motion.see(reading, bits, scan_s=scan_s, ratio=reads_ratio(self, unit))
        unit.onsets.see(reading.at, conditions_of(bits, reading), offline_after_s(scan_s))


def follower(unit: UnitLive) -> bool | None:
    """Whether #8 makes the unit follow a master by a ratio; None while it was not read."""
    mode = unit.parameter_raw(FOLLOWER_MODE)
    return None if mode is None else is_follower(mode)


def reads_ratio(bus: BusLive, unit: UnitLive) -> bool:
    """Whether commanded and actual speed of a unit are ratios to its master, in the dialect of its bus."""
    return bus.settings.follower_speed == "ratio" and bool(follower(unit))


def speed_decimals(bus: BusLive, unit: UnitLive) -> int | None:
    """The decimals of commanded and actual speed; None while #3 was not read."""
    return RATIO_DECIMALS if reads_ratio(bus, unit) else unit.parameter_raw(DECIMALS)


def never_seen(settings: BusSettings, at: float, cause: Message) -> BusLive:
    """A bus of which nothing is known, for ``cause``; first seen so at ``at``."""
    units = {
        unit.id: UnitLive(settings=unit, link=UnitLink(unit=unit.id, at=at, link="unknown"))
        for unit in settings.unit
    }
    first_seen = Onset(at, exact=False)
    return BusLive(settings, BusLink(at, "closed", cause), first_seen, first_seen, units=units)
