"""Counters and answer times of one unit. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bus.contract import UnitFigures

_SHORTEST_S = 0.0001
_STEP = 1.08
"""Answer times are counted in classes each 8 % wider than the one before, from 0.1 ms to 8 s."""
_CLASSES = 148


class AnswerTimes:
    """Seconds from a request's last byte to the first byte of the answer, as a histogram."""

    __slots__ = ("_classes", "count", "largest", "smallest")

    def __init__(self) -> None:
        self._classes = [0] * _CLASSES
        self.count = 0
        self.smallest: float | None = None
        self.largest: float | None = None

    def add(self, seconds: float) -> None:
        """One answer; a negative time (a port faster than its baud rate) counts as none at all."""
        seconds = max(seconds, 0.0)
        self.count += 1
        self._classes[_class_of(seconds)] += 1
        self.smallest = seconds if self.smallest is None else min(self.smallest, seconds)
        self.largest = seconds if self.largest is None else max(self.largest, seconds)

    def quantile(self, part: float) -> float | None:
        """The time that ``part`` (0 to 1) of the answers did not exceed; None before the first."""
        if self.smallest is None or self.largest is None:
            return None
        left = part * self.count
        for place, count in enumerate(self._classes):
            left -= count
            if left <= 0 and count:
                return min(max(_middle_of(place), self.smallest), self.largest)
        return self.largest


def _class_of(seconds: float) -> int:
    if seconds <= _SHORTEST_S:
        return 0
    return min(int(math.log(seconds / _SHORTEST_S) / math.log(_STEP)) + 1, _CLASSES - 1)


def _middle_of(place: int) -> float:
    return _SHORTEST_S * _STEP ** (place - 0.5) if place else 0.0


@dataclass(slots=True)
class UnitStatistics:
    """What became of every request to one unit since the worker started."""

    unit: int
    polls: int = 0
    answers: int = 0
    timeouts: int = 0
    retries: int = 0
    checksum_errors: int = 0
    foreign: int = 0
    late: int = 0
    naks: dict[int, int] = field(default_factory=dict)
    times: AnswerTimes = field(default_factory=AnswerTimes)

    def refused(self, code: int) -> None:
        """The unit said NAK."""
        self.naks[code] = self.naks.get(code, 0) + 1

    def figures(self) -> UnitFigures:
        """As the app gets it."""
        times = self.times
        return UnitFigures(
            unit=self.unit,
            polls=self.polls,
            answers=self.answers,
            timeouts=self.timeouts,
            retries=self.retries,
            checksum_errors=self.checksum_errors,
            foreign=self.foreign,
            late=self.late,
            naks=dict(self.naks),
            answer_s_min=times.smallest,
            answer_s_median=times.quantile(0.5),
            answer_s_p99=times.quantile(0.99),
            answer_s_max=times.largest,
        )
