"""How many events a line may cause in a log that is kept for good. Pure; ``now`` is monotonic, in seconds.

A contact that chatters, a port that opens and closes, or a worker that reports nonsense would fill the log
and hide everything else in it. Once a series has had its share, only its last event is kept, with a count: as
soon as the series is quiet, and else after pauses that double. The last state is always recorded.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

from bus.bucket import Bucket
from bus.instants import Monotonic

T = TypeVar("T")

BURST = 20
"""Events of one series that are recorded one by one."""
FORGIVEN_EVERY_S = 60.0
"""How long until a series may have one more of these."""
QUIET_S = 60.0
FIRST_PAUSE_S, MAX_PAUSE_S = 60.0, 3600.0
BURST_OF_ALL = 3_000
"""Events of all series of one bus: an emergency stop of 255 units, and their return, several times."""
FORGIVEN_OF_ALL_EVERY_S = 1.0


@dataclass(frozen=True, slots=True)
class Summary(Generic[T]):
    """The last of ``count`` events of a series, which came within ``seconds``."""

    last: T
    count: int
    seconds: float


@dataclass(slots=True)
class _Series(Generic[T]):
    bucket: Bucket
    last: T | None = None
    count: int = 0
    first_at: Monotonic = Monotonic(0.0)
    last_at: Monotonic = Monotonic(0.0)
    due_at: Monotonic = Monotonic(0.0)
    pause_s: float = FIRST_PAUSE_S


class EventBudget(Generic[T]):
    """For the events of one bus."""

    def __init__(self) -> None:
        self._all = Bucket(1 / FORGIVEN_OF_ALL_EVERY_S, BURST_OF_ALL)
        self._series: dict[Hashable, _Series[T]] = {}

    def admits(self, key: Hashable, event: T, now: Monotonic, *, burst: int = BURST, count: int = 1) -> bool:
        """Whether to record this event of a series, of which ``burst`` are recorded one by one; where not, it
        is kept for a summary, as ``count`` of them."""
        series = self._series.setdefault(key, _Series(Bucket(1 / FORGIVEN_EVERY_S, burst)))
        series.last_at = now
        if not series.count and series.bucket.has_room(now) and self._all.has_room(now):
            return series.bucket.take(now) and self._all.take(now)
        if not series.count:
            series.first_at, series.due_at = now, now + series.pause_s
        series.last, series.count = event, series.count + count
        return False

    def due(self, now: Monotonic, *, everything: bool = False) -> list[Summary[T]]:
        """The summaries to record now; ``everything``: all that is kept, because the server ends."""
        found = [
            self._summary(series, now)
            for series in self._series.values()
            if series.count and (everything or self._is_due(series, now))
        ]
        self._series = {key: one for key, one in self._series.items() if one.count or one.bucket.level(now)}
        return found

    def _is_due(self, series: _Series[T], now: Monotonic) -> bool:
        return now >= series.due_at or now - series.last_at >= QUIET_S

    def _summary(self, series: _Series[T], now: Monotonic) -> Summary[T]:
        assert series.last is not None
        summary = Summary(series.last, series.count, now - series.first_at)
        series.last, series.count = None, 0
        if now - series.last_at >= QUIET_S:
            series.pause_s = FIRST_PAUSE_S
        else:
            series.pause_s = min(2 * series.pause_s, MAX_PAUSE_S)
            series.bucket.fill(now)
        return summary
