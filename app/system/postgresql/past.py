"""Fills a past into the plant's database, from the stores as they are: the server may run or not."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

from app.core.database import StoreConnection
from app.line.history import tables
from app.line.history.series.runs import DAY, HOUR, SECOND
from app.line.history.unit_report import stored_tail
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import Batch, HistoryRows, alarms_between, events_between
from app.system.postgresql.rows import ALARM, EVENT, event_row
from bus.instants import unix_now

MAX_ROWS = 20_000
"""Rows that are sent together."""
PIECE = 4 * HOUR
Progress = Iterator[tuple[int, int]]
"""Up to when, µs, and how many rows were sent since the last one."""


def fill(
    site: StoreConnection,
    history: StoreConnection | None,
    destination: Destination,
    rows: HistoryRows,
    span: tuple[int, int],
) -> Progress:
    """Send everything of a span, µs: events, alarms, readings and minutes. Raises StoreError."""
    with _sending(destination) as sender:
        yield from _entries(site, sender, span)
        if history is not None:
            yield from _readings(history, sender, rows, span)


class _Sender:
    """Sends one batch while the next one is made."""

    def __init__(self, destination: Destination) -> None:
        self._destination = destination
        self._pool = ThreadPoolExecutor(1)
        self._pending: Future[None] | None = None

    def send(self, batch: Batch) -> int:
        """Begin to send a batch, once the one before is sent; return how many rows it has."""
        self.finish()
        if batch.size:
            self._pending = self._pool.submit(self._destination.send, batch, unix_now())
        return batch.size

    def finish(self) -> None:
        """Wait until everything is sent."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()

    def close(self) -> None:
        self._pool.shutdown()


@contextmanager
def _sending(destination: Destination) -> Iterator[_Sender]:
    sender = _Sender(destination)
    try:
        yield sender
        sender.finish()
    finally:
        sender.close()


def _entries(site: StoreConnection, sender: _Sender, span: tuple[int, int]) -> Progress:
    start, end = span[0] / SECOND, span[1] / SECOND
    after = 0
    while events := events_between(site, start, end, after):
        after = events[-1]["id"]
        batch = Batch()
        batch.add(EVENT, map(event_row, events))
        yield span[0], sender.send(batch)
    batch = Batch()
    batch.add(ALARM, alarms_between(site, start, end))
    yield span[0], sender.send(batch)


def _readings(
    history: StoreConnection, sender: _Sender, rows: HistoryRows, span: tuple[int, int]
) -> Progress:
    tail, stored = stored_tail(history), tables.extent(history)
    spans = [each for each in (stored, tail.extent()) if each]
    if not spans:
        return
    start = max(span[0], min(first for first, _ in spans))
    end = min(span[1], max(last for _, last in spans))
    start -= start % HOUR
    batch = Batch()
    while start < end:
        until = min(end, _end_of_piece(history, start))
        for unit in rows.units(history).values():
            rows.add_span(history, tail, unit, (start, until), batch)
            if batch.size >= MAX_ROWS:
                yield until, sender.send(batch)
                batch = Batch()
        start = until
    yield end, sender.send(batch)


def _end_of_piece(history: StoreConnection, start: int) -> int:
    """Return up to when is read at a time, µs: a day of minutes, a few hours of readings. The hours beside a
    piece are read with it, so a longer one costs less."""
    kept_from = tables.raw_from(history)
    return min(start + DAY, kept_from) if start < kept_from else start + PIECE
