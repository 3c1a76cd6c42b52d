"""Whether a value is outside its limits, with a deadband. Pure: numbers in the units of the value."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal

from app.conditions.condition import Tuning


@dataclass(frozen=True, slots=True)
class LimitRule:
    """``above`` and ``below``: where the condition begins; None: no such limit."""

    above: int | None
    below: int | None
    deadband: int = 0

    def holds(self, value: int, active: bool) -> bool:
        """An active condition ends only when the value is back by more than the deadband."""
        deadband = self.deadband if active else 0
        if self.above is not None and value > self.above - deadband:
            return True
        return self.below is not None and value < self.below + deadband


def limits_of(tuning: Tuning, full_scale: int) -> LimitRule:
    """The limits of an alarm, in the counts of its value."""

    def raw(percent: Decimal | None) -> int | None:
        return None if percent is None else round(percent * full_scale / 100)

    above, below = raw(tuning.above_percent), raw(tuning.below_percent)
    return LimitRule(max(1, above or 0), below, raw(tuning.deadband_percent) or 0)


@dataclass(slots=True)
class ChangeRate:
    """How fast a value changes, over at least ``SPAN_S``. Raises nothing for equal times."""

    SPAN_S = 1.0
    _at: float | None = None
    _value: int = 0
    _per_s: float | None = None

    def see(self, value: int, at: float) -> float | None:
        """The change per second up to a reading; None while it is not known."""
        if self._at is None or at < self._at:
            self._at, self._value = at, value
        elif at - self._at >= self.SPAN_S:
            self._per_s = abs(value - self._value) / (at - self._at)
            self._at, self._value = at, value
        return self._per_s

    def forget(self) -> None:
        """The value was not known for a while."""
        self._at = self._per_s = None
