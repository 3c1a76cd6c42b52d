"""What people may still add to the shifts: recent ones, so much an hour, while the disk has space."""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from math import ceil
from pathlib import Path

from app.core.database.files import MIN_FREE_OF_OTHERS, free_bytes
from app.core.web.admission.rate_limit import RateLimit
from app.errors import Problem
from app.records.handover.rules.shift_times import Shift
from bus.bucket import Bucket
from bus.instants import Clock, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message

MAX_AGE_DAYS = 31
"""How long ago a shift may have ended that gets notes or signatures: a plant may be closed for weeks."""
MAX_PER_HOUR = 60
"""Notes and pictures of one person: so many at once, then so many an hour."""
DAY_S, HOUR_S = 86_400.0, 3600.0


class Quota:
    """Bounds what each person stores. ``folder``: where the stores are."""

    def __init__(
        self, folder: Path, clock: Clock = unix_now, monotonic: MonotonicClock = monotonic_now
    ) -> None:
        self._folder = folder
        self._clock = clock
        self._monotonic = monotonic
        self._taken: defaultdict[str, Bucket] = defaultdict(
            partial(Bucket, MAX_PER_HOUR / HOUR_S, MAX_PER_HOUR)
        )

    def is_recent(self, shift: Shift) -> bool:
        """Whether a shift can still be written to."""
        return shift.end >= self._clock() - MAX_AGE_DAYS * DAY_S

    def check(self, shift: Shift) -> None:
        """Raises Problem 409 for a shift of long ago, 503 where the disk is kept for commands."""
        if not self.is_recent(shift):
            raise Problem(409, "not_in_state", Message.of("shift_too_old", n=MAX_AGE_DAYS))
        if free_bytes(self._folder) < MIN_FREE_OF_OTHERS:
            raise Problem(503, "store", Message("shift_disk_full"))

    def take(self, sender: str, parts: int) -> None:
        """Count a note with its pictures. Raises Problem 429 after too many of one sender."""
        bucket, now = self._taken[sender], self._monotonic()
        if not bucket.take(now, parts):
            problem = Problem(429, "too_many", Message.of("shift_quota_used", n=MAX_PER_HOUR))
            problem.headers.update(self.rate_limit(sender).headers)
            raise problem.with_headers(Retry_After=str(ceil(bucket.wait_s(now, parts))))

    def rate_limit(self, sender: str) -> RateLimit:
        """What this sender may still store."""
        return RateLimit.of(self._taken[sender], self._monotonic())
