"""The stored status bits of a unit as spans in which they stayed the same."""

from __future__ import annotations

from app.history.intake.tail import Tail
from app.history.series.intervals import Interval
from app.history.series.runs import micros
from app.history.service import History, seconds
from app.history.store import tables
from bus.instants import UnixTime

MOST_SPANS = 50_000
"""Bits that change more often than this over a span are not read."""
StatusSpan = tuple[UnixTime, UnixTime, int]


async def status_words(
    history: History, bus: str, unit: int, start: UnixTime, end: UnixTime
) -> list[StatusSpan]:
    """From when until when (Unix time, seconds) which bits, ST2 * 256 + ST1, in order of time. Raises
    StoreError."""
    wanted = micros(start), micros(end)

    def read(connection: tables.StoreConnection, tail: Tail) -> list[Interval]:
        key = tables.find_unit(connection, bus, unit)
        if key is None:
            return []
        recent = [Interval(run.at, run.until, run.word) for run in tail.runs(key, *wanted)]
        if tables.count_bits(connection, key, *wanted) > MOST_SPANS:
            return recent
        return tables.bits_around(connection, key, *wanted) + recent

    spans = sorted(await history.read(read))
    return [(seconds(span.at), seconds(span.until), span.word) for span in spans]
