"""How quickly one account may open WebSockets. Pure."""

from __future__ import annotations

from bus.bucket import Bucket

A_SECOND = 20.0
MOST_AT_ONCE = 300
"""All pages of a plant may have one account, and come back at once after a restart."""


class Handshakes:
    """Delays the handshakes of an account beyond their rate: who is refused asks again at once."""

    def __init__(self) -> None:
        self._buckets: dict[str, Bucket] = {}

    def wait_s(self, account: str, now: float) -> float:
        """How long one more handshake of ``account`` waits; ``now`` in seconds on any steady clock."""
        return self._buckets.setdefault(account, Bucket(A_SECOND, MOST_AT_ONCE)).pour(1, now)
