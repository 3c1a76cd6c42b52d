"""Which late updates of a worker are taken in: of the time that its bus was not followed, each once. Pure.

Times are Unix times of the app's clock. A worker delivers late in the order in which it read; what it
reported live, and what another worker reported, is not changed later.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf

from app.line.feed.plausibility import LIVE_S
from app.line.pipeline import KEPT
from bus.contract import Batch, Reading, Update
from bus.contract.actions import MAX_UPDATES
from bus.instants import UnixTime

FIRST_S = 900.0
"""How far back a first worker is believed, of whose bus nothing is stored: what it keeps at 9600 baud."""
REPEATED_S = 5.0
"""What a worker sends again after the app crashed, as it was not confirmed: it is stored."""
OFFSET_ERROR_S = 1.0
"""By how much the offset of the worker's clock may be wrong when it connects."""


@dataclass(slots=True)
class LateWindow:
    """What one connection may report late: after ``since``, up to ``until``."""

    since: UnixTime
    until: UnixTime
    _newest: dict[int, UnixTime] = field(default_factory=dict)
    """By unit its newest reading, by the worker's clock."""

    def admits(self, update: Update, offset_s: float, until: UnixTime) -> bool:
        """Whether a late update is of the time that was not followed, up to ``until``. ``offset_s``: by which
        its time was moved."""
        if not isinstance(update, KEPT):
            return True
        if not self.since < update.at <= until:
            return False
        return not isinstance(update, Reading) or self._is_next(update, offset_s)

    def is_repeated(self, update: Update) -> bool:
        """Whether it is sent again because the app ended before it was confirmed."""
        return isinstance(update, KEPT) and self.since - REPEATED_S < update.at <= self.since

    def is_known(self, update: Update) -> bool:
        """Whether a reading of a live batch is of the time before, though it is young enough to be live."""
        return isinstance(update, Reading) and self.since - LIVE_S < update.at <= self.since

    def _is_next(self, reading: Reading, offset_s: float) -> bool:
        """Whether it follows the last one of its unit, by the worker's clock, whose offset may change."""
        own_at = reading.at - offset_s
        if own_at <= self._newest.get(reading.unit, UnixTime(-inf)):
            return False
        self._newest[reading.unit] = own_at
        return True


@dataclass(slots=True)
class LateReadings:
    """How many readings came late, and of which span."""

    count: int = 0
    since: UnixTime = UnixTime(inf)
    until: UnixTime = UnixTime(-inf)

    def add(self, updates: Iterable[Update]) -> None:
        """Count those among late updates that were taken in."""
        times = [update.at for update in updates if isinstance(update, Reading)]
        self.count += len(times)
        self.since, self.until = min((self.since, *times)), max((self.until, *times))


@dataclass(slots=True)
class Coverage:
    """How far one bus was followed: up to ``until`` its readings are here, or missing for good. None: nothing
    is known of it."""

    until: UnixTime | None = None

    def window(self, now: UnixTime) -> LateWindow:
        """What a worker that connects now may report late."""
        if self.until is None:
            return LateWindow(now - FIRST_S, now + OFFSET_ERROR_S)
        # A clock that was set back must not refuse all that follows.
        self.until = min(self.until, now)
        return LateWindow(self.until, now + OFFSET_ERROR_S)

    def advance(self, batch: Batch, taken: list[Update], now: UnixTime) -> None:
        """Note what was taken in of a batch, its times by the app's clock. A live one that is not full holds
        everything until it was sent."""
        reached = [update.at for update in taken if isinstance(update, Reading)]
        if batch.live and len(batch.updates) < MAX_UPDATES:
            reached.append(batch.sent_at)
        if reached:
            self.until = max(self.until or UnixTime(0.0), min(max(reached), now))
