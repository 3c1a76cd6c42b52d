"""When zero was commanded to every unit of a bus. Pure. Times in µs."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence

ZeroStep = tuple[int, bool]
"""From when on zero, or another speed, was commanded to a unit."""
AtRest = Callable[[int], bool]


def rest_of(units: Sequence[Sequence[ZeroStep]]) -> AtRest:
    """Whether the line was at rest at a time, by the steps of each unit in order. One without any is no proof
    of rest; before its first step, a unit was as it is then."""
    if not units or not all(units):
        return lambda _: False
    states = [steps[0][1] for steps in units]
    times, found = [0], [all(states)]
    for at, unit, is_zero in sorted(
        (at, unit, zero) for unit, steps in enumerate(units) for at, zero in steps
    ):
        states[unit] = is_zero
        if all(states) != found[-1]:
            times.append(at)
            found.append(not found[-1])
    return lambda at: found[bisect_right(times, at) - 1]
