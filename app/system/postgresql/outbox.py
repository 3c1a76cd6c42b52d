"""The rows of the stores for the plant's database: those after the publisher's cursor, and those of a past
that is filled in.

The stores are the outbox: blocks of readings and entries of the logs have rising numbers, and the cursor is
the last that is in the plant's database. Rows that are sent twice are one row there. A past is read from the
stores as they are, whether or not the server runs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any

from app.core.database import StoreConnection
from app.core.database.connection import snapshot, upsert
from app.line.history import tables
from app.line.history.query import (
    SeriesQuery,
    StoredUnit,
    has_raw,
    minutes_of,
    rollups,
    runs_between,
    scale_of,
    stored_tail,
    stored_unit,
)
from app.line.history.recorder import Tail
from app.line.history.series.figures import RunFigures, minute_figures, runs_of_minutes, series
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, PlainRun, Run, runs_of
from app.line.history.series.values import VALUES, Marks, was_follower
from app.line.history.tables import BlockKey
from app.records.handover.figures import length_measure
from app.system.postgresql.destination import Destination
from app.system.postgresql.rows import (
    ALARM,
    EVENT,
    MINUTE_TABLE,
    READING,
    Batch,
    Row,
    Scales,
    alarm_row,
    event_row,
    lost_row,
    minute_rows,
    points_of,
    reading_rows,
    steps_of,
)
from bus.instants import unix_now
from bus.settings import BusSettings, UnitSettings

MAX_ENTRIES = 2000
"""The most events, and transitions of alarms, in one batch."""
MAX_SPAN = HOUR
"""The span of readings in one batch, summed over the units, µs: 10,000 to 20,000 readings."""
MAX_BLOCKS = MAX_SPAN // MINUTE
SETTLED = SECOND
"""The time after which the readings of a moment are published, µs. A later reading is published with its
minute."""
_EVER = 1 << 62


@dataclass(frozen=True, slots=True)
class Cursor:
    """The position up to which data is published. ``blocks``: the id of the last block of readings;
    ``events``, ``alarms``: of the last entry of the log and of the journal; ``until``: everything stored up
    to this time, µs, is published."""

    blocks: int
    events: int
    alarms: int
    until: int


_NAMES = tuple(each.name for each in fields(Cursor))


def read_cursor(connection: StoreConnection) -> Cursor | None:
    """Return the stored cursor; None if nothing was published yet."""
    found = dict(map(tuple, connection.execute("SELECT name, value FROM publisher_cursor")))
    return Cursor(**found) if found.keys() >= set(_NAMES) else None


def write_cursor(connection: StoreConnection, cursor: Cursor) -> None:
    """Store the cursor."""
    rows = [(name, getattr(cursor, name)) for name in _NAMES]
    connection.executemany(upsert("publisher_cursor", ("name",), ("value",)), rows)


def read_identity(connection: StoreConnection) -> str:
    """Return the id of the site in the plant's database: 32 hex digits that no other site has."""
    return str(connection.execute("SELECT id FROM publisher_identity").fetchone()[0])


def end_of_logs(connection: StoreConnection) -> tuple[int, int]:
    """Return the ids of the newest event and of the newest transition of an alarm; 0 if there is none."""
    query = "SELECT coalesce((SELECT max(id) FROM {}), 0)"
    return tuple(connection.execute(query.format(name)).fetchone()[0] for name in ("events", "alarm_journal"))


def end_of_blocks(connection: StoreConnection) -> int:
    """Return the id of the newest block of readings; 0 if there is none."""
    return int(connection.execute("SELECT coalesce(max(id), 0) FROM raw").fetchone()[0])


def first_block_since(connection: StoreConnection, at: int) -> int | None:
    """Return the least id of the blocks that begin at ``at`` or later, µs."""
    found = connection.execute("SELECT min(id) FROM raw WHERE start >= ?", (at,)).fetchone()[0]
    return None if found is None else int(found)


# --- events and alarms ---


def add_entries(connection: StoreConnection, cursor: Cursor, batch: Batch) -> tuple[Cursor, bool]:
    """Add the events and alarms after the cursor to a batch, up to its limit; return the cursor after them,
    and whether these were all."""
    query = "SELECT * FROM events WHERE id > ? ORDER BY id LIMIT ?"
    events = connection.execute(query, (cursor.events, MAX_ENTRIES)).fetchall()
    batch.add(EVENT, map(event_row, map(dict, events)))
    query = "SELECT id, alarm, occurrence FROM alarm_journal WHERE id > ? ORDER BY id LIMIT ?"
    changed = connection.execute(query, (cursor.alarms, MAX_ENTRIES)).fetchall()
    occurrences = dict.fromkeys((alarm, occurrence) for _, alarm, occurrence in changed)
    batch.add(ALARM, _alarm_rows(connection, occurrences))
    reached = replace(
        cursor,
        events=events[-1]["id"] if events else cursor.events,
        alarms=changed[-1]["id"] if changed else cursor.alarms,
    )
    return reached, max(len(events), len(changed)) < MAX_ENTRIES


def _alarm_rows(connection: StoreConnection, occurrences: Iterable[tuple[str, int]]) -> Iterator[Row]:
    for alarm, occurrence in occurrences:
        transitions: list[dict[str, Any]] = []
        query = "SELECT * FROM alarm_journal WHERE alarm = ? ORDER BY id DESC"
        for entry in connection.execute(query, (alarm,)):
            if entry["occurrence"] < occurrence:
                break
            if entry["occurrence"] == occurrence:
                transitions.insert(0, dict(entry))
        row = alarm_row(transitions)
        if row is not None:
            yield row


# --- readings ---


@dataclass(frozen=True, slots=True)
class PublishedUnit:
    """A unit of a configured bus, and the scales of its values."""

    key: int
    bus: BusSettings
    number: int
    scales: Scales
    settings: UnitSettings | None

    @property
    def place(self) -> tuple[str, int]:
        return self.bus.name, self.number


class HistoryRows:
    """The rows of the history of a site. ``step``: the distance of the rows in µs, 0 for every reading;
    ``damaged``: blocks that could not be read, until the caller empties the list."""

    def __init__(self, buses: Iterable[BusSettings], step: int) -> None:
        self._buses = {bus.name: bus for bus in buses}
        self._step = step
        self._known: tuple[object, ...] = ()
        self._units: dict[int, PublishedUnit] = {}
        self._lost: set[tuple[int, int, str]] = set()
        self.damaged: list[BlockKey] = []

    def units(self, connection: StoreConnection) -> dict[int, PublishedUnit]:
        """Return the units by their keys; they are read again after a new unit or scale."""
        query = "SELECT (SELECT count(*) FROM unit), count(*), max(at), total(raw) FROM parameter"
        known = tuple(connection.execute(query).fetchone())
        if known != self._known:
            rows = connection.execute("SELECT id, bus, number FROM unit WHERE number > 0").fetchall()
            found = [
                _unit(connection, key, self._buses[bus], n) for key, bus, n in rows if bus in self._buses
            ]
            self._known, self._units = known, {unit.key: unit for unit in found}
        return self._units

    def add_blocks(
        self, connection: StoreConnection, tail: Tail, cursor: Cursor, batch: Batch
    ) -> tuple[Cursor, bool]:
        """Add the blocks after the cursor to a batch, up to its limit; return the cursor after them, and
        whether these were all. Readings that were given up before they were published are added as
        minutes."""
        given_up = tables.raw_from(connection)
        if given_up > cursor.until:
            end = min(given_up, cursor.until - cursor.until % HOUR + HOUR)
            for unit in self.units(connection).values():
                self._add_minutes(connection, tail, unit, (cursor.until - cursor.until % MINUTE, end), batch)
            return replace(cursor, until=end), False
        units = self.units(connection)
        query = "SELECT id, unit, start, span FROM raw WHERE id > ? ORDER BY id LIMIT ?"
        blocks = connection.execute(query, (cursor.blocks, MAX_BLOCKS)).fetchall()
        spans = itertools.accumulate((span for _, _, _, span in blocks), initial=0)
        for (number, key, start, span), before in zip(blocks, spans, strict=False):
            if before + span > MAX_SPAN and before:
                return cursor, False
            if key in units:
                self.add_span(connection, tail, units[key], (start, start + span), batch)
            cursor = replace(cursor, blocks=number, until=max(cursor.until, start))
        return cursor, len(blocks) < MAX_BLOCKS

    def add_span(
        self,
        connection: StoreConnection,
        tail: Tail,
        unit: PublishedUnit,
        span: tuple[int, int],
        batch: Batch,
    ) -> None:
        """Add the readings and minutes of a unit over a span of whole minutes, µs."""
        start, end = span
        lost = tables.lost_between(connection, start, end + MINUTE, unit.key)
        batch.add(READING, (lost_row(unit.place, at, link) for _, at, link in lost))
        # A reading counts until the next one: the previous minute ends with the first of this one.
        runs = self._add_minutes(connection, tail, unit, (start - MINUTE, end), batch)
        within = [run for run in runs if start <= run.at < end]
        points = steps_of(within, self._step) if self._step else points_of(within)
        batch.add(READING, reading_rows(unit.place, points, unit.scales, unit.bus.estop_healthy))

    def _add_minutes(
        self,
        connection: StoreConnection,
        tail: Tail,
        unit: PublishedUnit,
        span: tuple[int, int],
        batch: Batch,
    ) -> list[Run]:
        """Add the minutes of a span; return the runs that are stored of it and of a minute around it."""
        start, end = span
        source = stored_unit(connection, tail, *unit.place, start - MINUTE, end + MINUTE)
        if source is None:
            return []
        with snapshot(connection):
            points = rollups(source, "minutes", VALUES["actual"], start, end)
            runs = runs_between(source, start - MINUTE, end + MINUTE)
            figures = None if self._is_ratio(source, unit, end) else _figures(source, unit, span, runs)
        # Each minute by itself: time between two readings does not matter here.
        alone = replace(points, solid=[True] * len(points.at))
        shown = series(alone, Marks(), unit.scales.actual)
        length = length_measure(unit.settings) if unit.settings else None
        batch.add(MINUTE_TABLE, minute_rows(unit.place, shown, points.weight, figures, length and length[1]))
        self.damaged += source.damaged
        return runs

    def _is_ratio(self, source: StoredUnit, unit: PublishedUnit, end: int) -> bool:
        if unit.bus.follower_speed != "ratio":
            return False
        return was_follower(tables.parameter_steps(source.connection, source.unit), end)

    def add_newest(
        self, connection: StoreConnection, tail: Tail, span: tuple[int, int], batch: Batch
    ) -> None:
        """Add the readings of a span that has just ended, µs, of which no block is stored yet."""
        units, (start, end) = self.units(connection), span
        for key, plain in tail.since(start).items():
            if key in units:
                points = ((at, run) for at, run in self._newest(plain) if start <= at < end)
                unit = units[key]
                batch.add(READING, reading_rows(unit.place, points, unit.scales, unit.bus.estop_healthy))

    def _newest(self, plain: Sequence[PlainRun]) -> Iterator[tuple[int, Run]]:
        runs = runs_of(plain)
        if self._step:
            return steps_of(runs, self._step)
        # The last run may go on: its end is known when it is over.
        return points_of([*runs[:-1], runs[-1]._replace(until=runs[-1].at)])

    def add_lost(self, connection: StoreConnection, since: int, batch: Batch) -> None:
        """Add the new moments from ``since`` on, µs, at which a unit or its bus was lost."""
        found = set(tables.lost_between(connection, since, _EVER))
        units = self.units(connection)
        lost = ((units[key].place, at, link) for key, at, link in found - self._lost if key in units)
        batch.add(READING, itertools.starmap(lost_row, lost))
        self._lost = found


def _unit(connection: StoreConnection, key: int, bus: BusSettings, number: int) -> PublishedUnit:
    source = StoredUnit(connection, key, ())
    commanded, actual, analog = (
        scale_of(source, SeriesQuery(bus, number, VALUES[name], 0, 0, 1)) for name in Scales._fields
    )
    settings = next((unit for unit in bus.unit if unit.id == number), None)
    return PublishedUnit(key, bus, number, Scales(commanded, actual, analog), settings)


def _figures(
    source: StoredUnit, unit: PublishedUnit, span: tuple[int, int], runs: Sequence[Run]
) -> dict[int, RunFigures]:
    """Return the figures of each minute of a span, from its runs if all are stored, else from averages."""
    start, end = span
    if not has_raw(source.connection, source.unit, start):
        runs = runs_of_minutes(minutes_of(source, start - MINUTE, end + MINUTE))
    marks = source.marks(start - MINUTE, end + MINUTE)
    return minute_figures(runs, marks, unit.scales.actual)


# --- the past ---

MAX_ROWS = 20_000
"""The most rows that are sent together."""
PIECE = 4 * HOUR


def fill(
    site: StoreConnection,
    history: StoreConnection | None,
    destination: Destination,
    rows: HistoryRows,
    span: tuple[int, int],
) -> Iterator[tuple[int, int]]:
    """Send all data of a span, µs: events, alarms, readings and minutes; each batch while the next is made.
    Yield the time up to which it was read, and the number of rows sent. Raise StoreError."""
    readings = () if history is None else _reading_batches(history, rows, span)
    with ThreadPoolExecutor(1) as thread:
        sending = thread.submit(lambda: None)
        for until, batch in itertools.chain(_entry_batches(site, span), readings):
            sending.result()
            sending = thread.submit(destination.send, batch, unix_now())
            yield until, batch.size
        sending.result()


def _entry_batches(site: StoreConnection, span: tuple[int, int]) -> Iterator[tuple[int, Batch]]:
    start, end = span[0] / SECOND, span[1] / SECOND
    query = "SELECT * FROM events WHERE id > ? AND time >= ? AND time < ? ORDER BY id LIMIT ?"
    after = 0
    while events := site.execute(query, (after, start, end, MAX_ENTRIES)).fetchall():
        after = events[-1]["id"]
        batch = Batch()
        batch.add(EVENT, map(event_row, map(dict, events)))
        yield span[0], batch
    query = (
        "SELECT DISTINCT alarm, occurrence FROM alarm_journal WHERE trigger = 'rise' AND at >= ? AND at < ?"
    )
    batch = Batch()
    batch.add(ALARM, _alarm_rows(site, map(tuple, site.execute(query, (start, end)).fetchall())))
    yield span[0], batch


def _reading_batches(
    history: StoreConnection, rows: HistoryRows, span: tuple[int, int]
) -> Iterator[tuple[int, Batch]]:
    tail, stored = stored_tail(history), tables.extent(history)
    spans = [each for each in (stored, tail.extent()) if each]
    start = max(span[0], min((first for first, _ in spans), default=span[1]))
    end = min(span[1], max((last for _, last in spans), default=span[0]))
    start -= start % HOUR
    batch = Batch()
    while start < end:
        # A day of minutes at a time, or a few hours of readings.
        kept_from = tables.raw_from(history)
        until = min(end, start + PIECE if start >= kept_from else min(start + DAY, kept_from))
        for unit in rows.units(history).values():
            rows.add_span(history, tail, unit, (start, until), batch)
            if batch.size >= MAX_ROWS:
                yield until, batch
                batch = Batch()
        start = until
    yield end, batch
