"""Looks up in the history, in the background, since when a condition holds that was there at the start."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

from app.errors import StoreError
from app.line.conditions.catalogue import STATUS
from app.line.live.bus_live import BusLive, LiveState, offline_after_s, scan_s_of
from app.line.live.unit_status import Onset, WordSpan, onset_in
from bus.catalogue.values import status_bits
from bus.instants import Clock, UnixTime

LOOK_EVERY_S = 1.0
LOOK_AFTER_S = (1.0, 10.0, 60.0)
"""How long after it was first seen: once the history has stored it, and again when a worker may have
delivered what it buffered meanwhile."""
HOUR_S, DAY_S = 3600.0, 86_400.0
BACK_S = (HOUR_S, DAY_S, 7 * DAY_S, 31 * DAY_S, 366 * DAY_S)
"""How far to look back, step by step until the beginning is found."""

StatusWords = Callable[[str, int, UnixTime, UnixTime], Awaitable[Sequence[WordSpan]]]
"""The stored status bits of a unit of a bus from one time to another, in order of time. Raises StoreError."""
OnsetKey = tuple[str, int, str, Onset]


@dataclass(eq=False)
class OnsetLookup:
    """Corrects the onsets of all units. ``_changed`` is called with bus and unit when an onset is
    corrected."""

    _live: LiveState
    _words: StatusWords
    _changed: Callable[[str, int], None]
    _clock: Clock
    _looked: dict[OnsetKey, int] = field(default_factory=dict)
    """How often each open onset was looked up."""
    _requested: set[tuple[str, int]] = field(default_factory=set)
    """The units whose last response before this start was looked up."""

    async def follow(self) -> None:
        """Look up open conditions, as long as the server runs."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            await self.look()

    async def look(self) -> None:
        """Look up each open onset that is due, and the last response of units that have not responded yet."""
        for bus_name, number in self._unread():
            try:
                self._live.buses[bus_name].units[number].last_response = await self._last_end(
                    bus_name, number
                )
            except StoreError:
                break
            self._requested.add((bus_name, number))
        self._looked = {key: self._looked.get(key, 0) for key in self._open()}
        for key, times in list(self._looked.items()):
            if times < len(LOOK_AFTER_S) and self._clock() - key[3].at >= LOOK_AFTER_S[times]:
                self._looked[key] += 1
                await self._look_up(*key)

    def _unread(self) -> list[tuple[str, int]]:
        units = [
            (bus.settings.name, number)
            for bus in self._live.buses.values()
            for number, unit in bus.units.items()
            if unit.reading is None
        ]
        return [unit for unit in units if unit not in self._requested]

    def _open(self) -> list[OnsetKey]:
        return [
            (bus.settings.name, number, name, onset)
            for bus in self._live.buses.values()
            for number, unit in bus.units.items()
            for name, onset in unit.onsets.since.items()
            if name in STATUS and not onset.exact
        ]

    async def _look_up(self, bus_name: str, number: int, name: str, seen: Onset) -> None:
        bus = self._live.buses[bus_name]
        try:
            found = await self._find(bus, number, name, seen)
        except StoreError:
            return
        if bus.units[number].onsets.correct(name, seen, found):
            self._changed(bus_name, number)

    async def _last_end(self, bus: str, number: int) -> UnixTime | None:
        now = self._clock()
        for back_s in BACK_S:
            if spans := await self._words(bus, number, now - back_s, now):
                return spans[-1][1]
        return None

    async def _find(self, bus: BusLive, number: int, name: str, seen: Onset) -> Onset:
        found = seen
        for back_s in BACK_S:
            spans = await self._words(bus.settings.name, number, seen.at - back_s, seen.at)
            found, complete = onset_in(spans, _holds(bus, name), seen, offline_after_s(scan_s_of(bus)))
            if complete:
                break
        return found


def _holds(bus: BusLive, name: str) -> Callable[[int], bool]:
    holds, healthy = STATUS[name], bus.settings.estop_healthy
    return lambda word: holds(status_bits(word >> 8, word & 0xFF, healthy))
