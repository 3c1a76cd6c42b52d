"""Limits how quickly one account may open WebSockets. Pure."""

from __future__ import annotations

from bus.bucket import Bucket
from bus.instants import Monotonic

A_SECOND = 20.0
MAX_AT_ONCE = 300
"""All pages of a plant may have one account, and come back at once after a restart;"""
MAX_TOGETHER_A_SECOND, MAX_TOGETHER = 60.0, 10
"""but not all together: to open one takes the event loop milliseconds."""


class Handshakes:
    """Delays the handshakes of an account beyond their rate: refused clients retry at once."""

    def __init__(self) -> None:
        self._buckets: dict[str, tuple[Bucket, Bucket]] = {}

    def wait_s(self, account: str, now: Monotonic) -> float:
        """Return how long one more handshake of ``account`` waits; ``now`` in seconds on any steady clock."""
        fresh = Bucket(A_SECOND, MAX_AT_ONCE), Bucket(MAX_TOGETHER_A_SECOND, MAX_TOGETHER)
        return max(bucket.pour(1, now) for bucket in self._buckets.setdefault(account, fresh))
