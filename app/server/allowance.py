"""How often something may be done. Pure: times are seconds; a clock that steps back costs nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Allowance:
    """A token bucket: ``rate`` a second, ``most`` at once, full at ``at``."""

    rate: float
    most: float
    at: float
    _left: float = -1.0

    def __post_init__(self) -> None:
        self._left = self.most

    def take(self, now: float) -> bool:
        """Use one, where there is one."""
        self._left = min(self.most, self._left + max(0.0, now - self.at) * self.rate)
        self.at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True
