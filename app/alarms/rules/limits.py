"""Whether a value is outside its limits, with a deadband. Pure: numbers in the units of the value."""

from __future__ import annotations

from dataclasses import dataclass


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
