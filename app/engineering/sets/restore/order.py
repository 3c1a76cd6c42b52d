"""Orders the rows of a restore so that no intermediate state is worse than its start or end. Pure.

Each row takes effect at once, so a unit runs for a moment on a mixture of old and new values. Bounds are
widened before the values that they bound and narrowed after them. What slows a running unit comes before
what makes it faster: on the way it is never faster than before or afterwards.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from bus.catalogue import numbers

INVERSE_FOLLOWER = 2
"""#8 of a unit that slows down as its ratio goes up (manual, 4.0)."""
_MEANING = (numbers.DECIMALS, numbers.FOLLOWER_MODE)
_MAXIMA, _MINIMA = frozenset({numbers.MAX_DISPLAY, numbers.MAX_RATIO}), frozenset({numbers.MIN_RATIO})
_FASTER_UPWARD = frozenset(
    {
        numbers.MAX_RPM,
        numbers.BASE_RATIO,
        numbers.ENCODER_PPR,
        numbers.PRESET_SPEED,
        numbers.JUMP_UP,
        numbers.SPEED_SETPOINT,
        numbers.RATIO_SETPOINT,
    }
)
_SLOWER_UPWARD = frozenset({numbers.JUMP_DOWN})
"""The motor speed is the setpoint * #1 / #2 by the pulses of #5; in a follower that of the master * #4 * #37.
#2 is among the bounds. #9 to #11 take the place of the setpoint, or move it, while their inputs are on."""
_ENDS_TALK = (numbers.PASSWORD, numbers.PROTOCOL, numbers.BAUD_RATE, numbers.CONTROL_MODE)
"""What may end the conversation comes when everything else is done."""
_BOUNDS = ((numbers.ANALOG_IN_LOW, numbers.ANALOG_IN_HIGH), (numbers.ANALOG_OUT_LOW, numbers.ANALOG_OUT_HIGH))
"""(low, high) pairs whose ends bound each other and nothing else."""


@dataclass(frozen=True, slots=True)
class Write:
    """One row to write."""

    number: int
    present: int
    wanted: int

    @property
    def up(self) -> bool:
        """Whether the value grows."""
        return self.wanted > self.present


class _Step(IntEnum):
    ALLOW_SETUP = 0
    MEANING = 1
    WIDEN = 2
    SLOWER = 3
    OTHERS = 4
    FASTER = 5
    NARROW = 6
    FORBID_SETUP = 7
    ENDS_TALK = 8


def in_order(writes: Iterable[Write], *, mode: int | None) -> tuple[Write, ...]:
    """``mode``: #8 of the unit as it is now, None where not known."""
    ordered = sorted(writes, key=lambda write: _rank(write, mode))
    for low, high in _BOUNDS:
        _widen_first(ordered, low, high)
    return tuple(ordered)


def _rank(write: Write, mode: int | None) -> tuple[_Step, int]:
    number = write.number
    if number in _MEANING:
        return _Step.MEANING, _MEANING.index(number)
    if number in _ENDS_TALK:
        return _Step.ENDS_TALK, _ENDS_TALK.index(number)
    return _step(write, mode), number


def _step(write: Write, mode: int | None) -> _Step:
    number = write.number
    if number == numbers.SETUP_DURING_RUN:
        return _Step.ALLOW_SETUP if write.wanted else _Step.FORBID_SETUP
    if number in _MAXIMA:
        return _Step.WIDEN if write.up else _Step.NARROW
    if number in _MINIMA:
        return _Step.NARROW if write.up else _Step.WIDEN
    if number in _FASTER_UPWARD | _SLOWER_UPWARD:
        inverse = number in _SLOWER_UPWARD or (number == numbers.RATIO_SETPOINT and mode == INVERSE_FOLLOWER)
        return _Step.FASTER if write.up != inverse else _Step.SLOWER
    return _Step.OTHERS


def _widen_first(ordered: list[Write], low: int, high: int) -> None:
    """Exchange the two where the present order would lead to low > high on the way."""
    at = {write.number: index for index, write in enumerate(ordered) if write.number in (low, high)}
    if len(at) < 2:
        return
    lower, upper = ordered[at[low]], ordered[at[high]]
    wanted_first = upper if lower.wanted > upper.present else lower
    first, second = sorted(at.values())
    ordered[first] = wanted_first
    ordered[second] = lower if wanted_first is upper else upper
