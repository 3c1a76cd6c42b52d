"""How long a command may wait after the moment at which it was made."""

from __future__ import annotations

from dataclasses import dataclass

from app.errors import Problem
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message, number

DEFAULT_TIMEOUT_S = 2.0
"""How long after it was made a write may still be sent, by default."""


@dataclass(frozen=True, slots=True)
class Deadline:
    """The last moment at which a command may be sent: ``timeout_s`` seconds after it was made."""

    made_at: Monotonic
    timeout_s: float

    @classmethod
    def within(cls, timeout_s: float) -> Deadline:
        """The deadline of a command that is made now."""
        return cls(monotonic_now(), timeout_s)

    @property
    def left_s(self) -> float:
        """Seconds until then; negative once it has passed."""
        return self.made_at + self.timeout_s - monotonic_now()

    def refuse_passed(self, now: Monotonic | None = None) -> None:
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
