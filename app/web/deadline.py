"""How long a command may wait: one type for the moment at which it was made, one for its deadline.

A moment and a duration are both floats, and one in the place of the other is a command that acts an hour late
or never. Here they have types of their own, so that the type checker tells them apart.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NewType

from app.errors import Problem
from bus.messages import Message, number

Instant = NewType("Instant", float)
"""A moment on this process's monotonic clock, seconds."""
DEFAULT_TIMEOUT_S = 2.0
"""How long after it was made a write may still be sent, where nobody says otherwise."""


def instant_now() -> Instant:
    """This moment."""
    return Instant(time.monotonic())


@dataclass(frozen=True, slots=True)
class Deadline:
    """The last moment at which a command may be sent: ``timeout_s`` seconds after it was made."""

    made_at: Instant
    timeout_s: float

    @classmethod
    def within(cls, timeout_s: float) -> Deadline:
        """The deadline of what is made now."""
        return cls(instant_now(), timeout_s)

    @property
    def left_s(self) -> float:
        """Seconds until then; negative once it has passed."""
        return self.made_at + self.timeout_s - instant_now()

    def refuse_passed(self, now: Instant | None = None) -> None:
        """Raises Problem 503 ``not_sent`` once it has passed, or had by ``now``."""
        left_s = self.left_s if now is None else self.made_at + self.timeout_s - now
        if left_s > 0:
            return
        raise Problem(
            503,
            "not_sent",
            Message.of(
                "came_too_late",
                age=number(f"{self.timeout_s - left_s:.1f}"),
                allowed=number(f"{self.timeout_s:.3g}"),
            ),
            outcome="not_sent",
        )
