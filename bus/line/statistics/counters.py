"""What became of every byte and every exchange since the worker started. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from msgspec.structs import asdict

from bus.contract import UnitCounts, UnitFigures
from bus.wire.commands import Nak, ReadStatusRequest, Reply, Request


@dataclass(slots=True)
class WireCounts:
    """What the bus carried."""

    busy_s: float = 0.0
    noise_bytes: int = 0
    echoes: int = 0


_SHORTEST_S = 0.0001
_STEP = 1.08
"""Response times are counted in classes each 8 % wider than the one before, from 0.1 ms to 8 s."""
_CLASSES = 148


class ResponseTimes:
    """Seconds from a request's last byte to the first byte of the response, as a histogram."""

    __slots__ = ("_classes", "count", "largest", "smallest")

    def __init__(self) -> None:
        self._classes = [0] * _CLASSES
        self.count = 0
        self.smallest: float | None = None
        self.largest: float | None = None

    def add(self, seconds: float) -> None:
        """Add one response; a negative time (a port faster than its baud rate) counts as zero."""
        seconds = max(seconds, 0.0)
        self.count += 1
        self._classes[_class_of(seconds)] += 1
        self.smallest = seconds if self.smallest is None else min(self.smallest, seconds)
        self.largest = seconds if self.largest is None else max(self.largest, seconds)

    def quantile(self, part: float) -> float | None:
        """Return the time that ``part`` (0 to 1) of the responses did not exceed; None before the first."""
        if self.smallest is None or self.largest is None:
            return None
        left = part * self.count
        # Every second, twice for each unit of the line: the empty classes before the first are passed over.
        for place in range(_class_of(self.smallest), _CLASSES):
            left -= self._classes[place]
            if left <= 0 and self._classes[place]:
                middle = _SHORTEST_S * _STEP ** (place - 0.5) if place else 0.0
                return min(max(middle, self.smallest), self.largest)
        return self.largest


def _class_of(seconds: float) -> int:
    if seconds <= _SHORTEST_S:
        return 0
    return min(int(math.log(seconds / _SHORTEST_S) / math.log(_STEP)) + 1, _CLASSES - 1)


class UnitStatistics:
    """What became of every request to one unit."""

    __slots__ = ("counts", "times")

    def __init__(self, unit: int) -> None:
        self.counts = UnitCounts(unit)
        self.times = ResponseTimes()

    def count(self, request: Request, reply: Reply | None, response_s: float) -> None:
        """Count an exchange; ``response_s``: from the request's last byte to the first of ``reply``."""
        self.counts.polls += isinstance(request, ReadStatusRequest)
        if reply is None:
            self.counts.timeouts += 1
            return
        self.counts.responses += 1
        self.times.add(response_s)
        if isinstance(reply, Nak):
            # A new dictionary, because the one before may have been reported.
            naks = self.counts.naks
            self.counts.naks = {**naks, reply.code: naks.get(reply.code, 0) + 1}

    def figures(self) -> UnitFigures:
        times = self.times
        return UnitFigures(
            **asdict(self.counts),
            response_s_min=times.smallest,
            response_s_median=times.quantile(0.5),
            response_s_p99=times.quantile(0.99),
            response_s_max=times.largest,
        )
