"""The trace as a text file: one frame a line, time, direction, bytes and meaning between tabs.

``2026-11-21T02:01:33.123456+00:00  out  10 02 04 81 10 03 7B  unit 4: read speed and status``
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, Protocol, cast

from bus.errors import CallerError

Direction = Literal["out", "in"]
_DIRECTIONS = ("out", "in")


class PassedFrame(Protocol):
    """What a line is made of; ``bus.contract.Frame`` is one."""

    @property
    def at(self) -> float:
        """Seconds since the epoch."""

    @property
    def direction(self) -> Direction:
        """Out to the units or in from them."""

    @property
    def data(self) -> bytes:
        """The bytes as they passed."""

    @property
    def meaning(self) -> str:
        """In words."""


@dataclass(frozen=True, slots=True)
class TracedFrame:
    """A line read back. ``at``: seconds since the epoch."""

    at: float
    direction: Direction
    data: bytes
    meaning: str


def trace_line(frame: PassedFrame) -> str:
    """One line without its end."""
    time = datetime.fromtimestamp(frame.at, UTC).isoformat(timespec="microseconds")
    meaning = " ".join(frame.meaning.split())
    return f"{time}\t{frame.direction}\t{frame.data.hex(' ').upper()}\t{meaning}"


def is_trace_line(line: str) -> bool:
    """Whether ``line`` is meant to be a line of a trace, right or wrong."""
    return line.count("\t") == 3 and line.split("\t")[1] in _DIRECTIONS


def parse_trace_line(line: str) -> TracedFrame:
    """Raises CallerError for what ``trace_line`` did not write."""
    try:
        time, direction, data, meaning = line.rstrip("\r\n").split("\t")
        if direction not in _DIRECTIONS:
            raise ValueError(f"direction {direction!r}")
        at = datetime.fromisoformat(time).timestamp()
        return TracedFrame(at, cast(Direction, direction), bytes.fromhex(data), meaning)
    except ValueError as error:
        raise CallerError(f"not a line of a trace ({error}): {line.strip()[:60]}") from error
