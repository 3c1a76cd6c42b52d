"""How many acts an account performs: each is an event in a log that is kept for good."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field

from app.errors import Problem
from app.web.admission.rate_limit import RateLimit
from bus.bucket import Bucket
from bus.instants import Monotonic
from bus.messages import Message

MAX_ACTS, ACTS_PER_S = 600, 5.0
"""At once, and in the long run: more than a program acknowledges in a flood of alarms."""


@dataclass(eq=False)
class ActLimit:
    """Counts the acts of each account. Commands are not among them: the wire bounds those."""

    _performed: defaultdict[str, Bucket] = field(
        default_factory=lambda: defaultdict(lambda: Bucket(ACTS_PER_S, MAX_ACTS)), init=False
    )

    def count(self, account: str, now: Monotonic) -> None:
        """Count one more act. Raises Problem 429 with the time to wait."""
        performed = self._performed[account]
        if performed.take(now):
            return
        seconds = math.ceil(performed.wait_s(now))
        problem = Problem(429, "too_many", Message.of("acts_too_many", n=seconds))
        problem.headers.update(RateLimit.of(performed, now).headers)
        raise problem.with_headers(Retry_After=str(seconds))
