"""Levels of a filling disk: a warning, then the oldest readings go, then history pauses for the events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Space = Literal["enough", "low", "scarce", "none"]
_MB = 1_000_000


@dataclass(frozen=True, slots=True)
class DiskReserve:
    """Free bytes below which each thing happens."""

    announce: int = 2_000 * _MB
    """Warn on every page that shows history."""
    trim: int = 500 * _MB
    """Give up the oldest readings; minutes and hours stay."""
    pause: int = 100 * _MB
    """Write no history: the remaining space belongs to the events."""


def space(free: int, reserve: DiskReserve) -> Space:
    """What so many free bytes mean."""
    if free < reserve.pause:
        return "none"
    if free < reserve.trim:
        return "scarce"
    return "low" if free < reserve.announce else "enough"
