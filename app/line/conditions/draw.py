"""Draw: by how much a section of a line is faster than the section before it, in percent. Pure."""

from __future__ import annotations

from decimal import Decimal
from typing import Literal, NamedTuple

from bus.settings import DrawBand

DrawState = Literal["in_band", "out_of_band", "unknown", "none"]
"""``unknown``: a speed is not of the present; ``none``: there is no draw, or no band to judge it by."""
DRAW_DECIMALS = 1
MAX_TENTHS = 99_999
"""The largest draw in tenths of a percent: a section beside one that crawls would have millions."""
_TENTHS = 1000
"""Tenths of a percent in the whole."""


class SectionSpeed(NamedTuple):
    """A speed as a unit reports it. ``raw`` None: it is not of the present; ``decimals``: those of its
    display (#3), None while not known; ``quantity``: the measure of its display, such as m/min; None for a
    ratio to a master, which is no speed."""

    raw: int | None
    decimals: int | None
    quantity: str | None


class Draw(NamedTuple):
    """A draw. ``tenths``: of a percent, at most `MAX_TENTHS`; None if there is none or it is not known."""

    state: DrawState
    tenths: int | None = None


NO_DRAW, UNKNOWN_DRAW = Draw("none"), Draw("unknown")


def draw_between(before: SectionSpeed, section: SectionSpeed, band: DrawBand, *, judged: bool = True) -> Draw:
    """Return the draw of a section to the one before: none while either stands or their displays have
    different quantities. ``judged`` False: a draw out of its band means nothing now, for example while a
    section ramps."""
    if before.quantity is None or before.quantity != section.quantity or 0 in (before.raw, section.raw):
        return NO_DRAW
    if before.raw is None or section.raw is None or before.decimals is None or section.decimals is None:
        return UNKNOWN_DRAW
    tenths = _tenths(before.raw * 10**section.decimals, section.raw * 10**before.decimals)
    if not (band and judged):
        return Draw("none", tenths)
    low, high = band
    return Draw("in_band" if low <= percent_of(tenths) <= high else "out_of_band", tenths)


def percent_of(tenths: int) -> Decimal:
    """Return a draw as a number of percent."""
    return Decimal(tenths).scaleb(-DRAW_DECIMALS)


def _tenths(before: int, section: int) -> int:
    """Return tenths of a percent, rounded once, half away from zero, so that the judged draw is the shown
    one."""
    size = (2 * _TENTHS * abs(section - before) + before) // (2 * before)
    return min(size, MAX_TENTHS) if section >= before else -size
