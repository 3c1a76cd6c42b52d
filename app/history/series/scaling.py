"""Converts the integers of the wire to display units, with the parameters in force at that time.

#3 (decimals), #22 and #23 (analog input at 0 and at 255) and, where CS and AS are a ratio,
#8. Readings are kept as sent; each parameter is kept with the time at which it was read, and a
reading is shown with what was last read before it. Before the first, that first one counts.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from app.history.series.values import Value
from bus.catalogue.numbers import ANALOG_IN_HIGH, ANALOG_IN_LOW, DECIMALS, FOLLOWER_MODE
from bus.catalogue.values import RATIO_DECIMALS

DECIDING = (DECIMALS, FOLLOWER_MODE, ANALOG_IN_LOW, ANALOG_IN_HIGH)
_MASTER = 0
_MAX_DECIMALS = 4
_ANALOG_FULL = 255


class ParameterStep(NamedTuple):
    """A parameter had this raw value from ``at`` on (µs)."""

    at: int
    number: int
    raw: int


@dataclass(frozen=True, slots=True)
class LinearScale:
    """value = offset + raw * rise / per. ``decimals`` None: not known, or not a fixed number."""

    offset: int = 0
    rise: int = 1
    per: int = 1
    decimals: int | None = None

    def apply(self, raw: float) -> float:
        """A raw value, or an average of raw values, in display units."""
        return self.offset + raw * self.rise / self.per

    def apply_all(self, raws: Iterable[float]) -> list[float]:
        offset, rise, per = self.offset, self.rise, self.per
        return [offset + raw * rise / per for raw in raws]

    @property
    def falling(self) -> bool:
        """Whether the greatest raw value is the least shown."""
        return self.rise < 0


@dataclass(frozen=True, slots=True)
class Scaling:
    """Scales in order of time; the first also counts for all time before it."""

    since: Sequence[int]
    scales: Sequence[LinearScale]

    def at(self, time: int) -> LinearScale:
        """The scale in force at a time in µs."""
        return self.scales[max(0, bisect_right(self.since, time) - 1)]

    def stretches(self, times: Sequence[int]) -> Iterator[tuple[int, int, LinearScale]]:
        """Split times in order into ranges of positions, each with the scale in force."""
        i = 0
        while i < len(times):
            place = max(1, bisect_right(self.since, times[i]))
            j = bisect_left(times, self.since[place], i) if place < len(self.since) else len(times)
            yield i, j, self.scales[place - 1]
            i = j


def scaling(value: Value, steps: Sequence[ParameterStep], *, ratio: bool, estop_healthy: int) -> Scaling:
    """``ratio``: CS and AS of a follower are ratios (by the bus's dialect)."""
    if value.kind == "bit":
        inverted = value.name == "estop" and estop_healthy == 1
        return Scaling([0], [LinearScale(1, -1, 1, 0) if inverted else LinearScale(decimals=0)])
    known: dict[int, int] = {}
    for step in sorted(steps, reverse=True):
        known[step.number] = step.raw
    since, scales = [0], [_scale(value, known, ratio)]
    for step in sorted(steps):
        known[step.number] = step.raw
        since.append(step.at)
        scales.append(_scale(value, known, ratio))
    return Scaling(since, scales)


def _scale(value: Value, known: dict[int, int], ratio: bool) -> LinearScale:
    if value.kind == "analog":
        low, high = known.get(ANALOG_IN_LOW), known.get(ANALOG_IN_HIGH)
        if low is None or high is None:
            return LinearScale()
        return LinearScale(low, high - low, _ANALOG_FULL)
    decimals = known.get(DECIMALS)
    if ratio and known.get(FOLLOWER_MODE, _MASTER) != _MASTER:
        decimals = RATIO_DECIMALS
    if decimals is None or decimals > _MAX_DECIMALS:
        return LinearScale()
    return LinearScale(per=10**decimals, decimals=decimals)
