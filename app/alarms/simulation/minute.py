"""What a minute of which only the extremes are stored proves of a condition. Pure."""

from __future__ import annotations

from app.history.series.rollup import Rollup
from app.history.series.runs import SECOND
from bus.contract import Reading
from bus.instants import UnixTime


def extremes(unit: int, value: str, row: Rollup) -> tuple[Reading, Reading]:
    """Two readings with the least and the greatest that ``value`` can have been; for a bit: with what was on
    in every reading, and what in any. Neither needs to have been sent."""
    speeds = (row.commanded_min, row.actual_min), (row.commanded_max, row.actual_max)
    if value == "deviation":
        # Where the two ranges overlap, they may have been equal.
        common = max(row.commanded_min, row.actual_min)
        apart = (row.commanded_min, row.actual_max), (row.commanded_max, row.actual_min)
        least = common, min(common, row.commanded_max, row.actual_max)
        speeds = least, max(apart, key=lambda pair: abs(pair[0] - pair[1]))
    at = UnixTime(row.start / SECOND)
    rest = ((row.analog_min, row.word_and), (row.analog_max, row.word_or))
    first, last = (
        Reading(unit, at, *speed, analog, word >> 8, word & 0xFF)
        for speed, (analog, word) in zip(speeds, rest, strict=True)
    )
    return first, last
