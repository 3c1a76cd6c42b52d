"""The files of the spool as facts: their order, their bounds, and what gives way to what is newer. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from app.history.spool.records import Facts


@dataclass(slots=True)
class Segment:
    """One file. ``first`` names it, ``last`` is the number of its last record; times in µs, 0 without any."""

    first: int
    last: int = 0
    size: int = 0
    readings: int = 0
    begin: int = 0
    end: int = 0
    damaged: int = 0
    """Places before its last record at which there is none that is intact."""

    def add(self, facts: Facts, size: int) -> None:
        """A record of so many bytes was appended."""
        self.last, self.size, self.readings = facts.number, self.size + size, self.readings + facts.readings
        if facts.readings:
            self.begin = min(self.begin or facts.begin, facts.begin)
            self.end = max(self.end, facts.end)


@dataclass(frozen=True, slots=True)
class SpoolContents:
    """What waits in the spool: bytes on the disk, readings, and their span in µs."""

    size: int = 0
    readings: int = 0
    begin: int = 0
    end: int = 0
    damaged: int = 0


def contents_of(segments: Iterable[Segment]) -> SpoolContents:
    """All segments together."""
    found = [segment for segment in segments if segment.last]
    return SpoolContents(
        sum(segment.size for segment in found),
        sum(segment.readings for segment in found),
        min((segment.begin for segment in found if segment.begin), default=0),
        max((segment.end for segment in found), default=0),
        sum(segment.damaged for segment in found),
    )


def to_give_up(segments: Sequence[Segment], needed: int, most: int) -> list[Segment]:
    """The oldest segments that give way so that ``needed`` bytes more are at most ``most`` in all. The last
    one, which is being written, stays."""
    total, given_up = sum(segment.size for segment in segments) + needed, []
    for segment in segments[:-1]:
        if total <= most:
            break
        given_up.append(segment)
        total -= segment.size
    return given_up
