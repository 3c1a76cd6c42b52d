"""The rows of the history store. Every function takes a connection; its caller decides on the transaction.

zlib's checksum detects a damaged block, which costs only itself.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import gt, itemgetter, sub
from typing import Literal, TypeVar

from app.core.database import StoreConnection as StoreConnection
from app.core.database.connection import has_table, upsert
from app.line.history.series.runs import (
    DAY,
    HOUR,
    MINUTE,
    PlainRun,
    Rollup,
    Run,
    pack_columns,
    pack_integers,
    pack_rollups,
    unpack_columns,
    unpack_integers,
    unpack_rollups,
    unpack_runs,
)
from app.line.history.series.values import Interval, Marks, ParameterStep

T = TypeVar("T")
StoredTier = Literal["raw", "minutes", "hours"]


@dataclass(frozen=True, slots=True, order=True)
class BlockKey:
    """The place of a block: ``unit`` is a key, ``start`` in µs."""

    tier: StoredTier
    unit: int
    start: int


class DamagedBlock(ValueError):
    """Raised when the content of a block is not what was written."""

    def __init__(self, block: BlockKey, why: str) -> None:
        super().__init__(f"{why} ({block.tier} of unit key {block.unit} from {block.start})")
        self.block = block


def intact(block: BlockKey, unpack: Callable[[], T]) -> T:
    """Return the result of ``unpack``. Raise DamagedBlock if that raises ValueError."""
    try:
        return unpack()
    except ValueError as error:
        raise DamagedBlock(block, str(error)) from error


def sound(blob: bytes) -> bool:
    """Return whether a block still has its checksum."""
    try:
        zlib.decompress(blob)
    except zlib.error:
        return False
    return True


RollupTier = Literal["minutes", "hours"]
ROW_SPAN: dict[RollupTier, int] = {"minutes": HOUR, "hours": DAY}
"""The span of one row of a tier, µs."""
STEP: dict[RollupTier, int] = {"minutes": MINUTE, "hours": HOUR}
IMPLAUSIBLE = "implausible"
"""State of a unit that responds, but with a speed that the manual rules out."""
LOST_STATES = ("stale", "offline", "unknown", "closed", IMPLAUSIBLE)
_JOURNAL_LEVEL = 1
INSERT_RAW = "INSERT INTO raw (unit, start, span, points, data, id) VALUES (?, ?, ?, ?, ?, ?)"
_RESERVE_IDS = """
INSERT INTO fact VALUES ('raw_id', (SELECT coalesce(max(id), strftime('%s', 'now') * 1000) FROM raw) + :count)
ON CONFLICT (name) DO UPDATE SET value = max(value, coalesce((SELECT max(id) FROM raw), 0)) + :count
RETURNING value
"""


def unit_id(connection: StoreConnection, bus: str, number: int) -> int:
    """Return the key of a unit (number 0: of the bus itself), and make one if it has none."""
    connection.execute("INSERT INTO unit (bus, number) VALUES (?, ?) ON CONFLICT DO NOTHING", (bus, number))
    found = find_unit(connection, bus, number)
    assert found is not None
    return found


def find_unit(connection: StoreConnection, bus: str, number: int) -> int | None:
    """Return the key of a unit; None if nothing of it was ever stored."""
    row = connection.execute("SELECT id FROM unit WHERE bus = ? AND number = ?", (bus, number)).fetchone()
    return None if row is None else int(row[0])


def units_of(connection: StoreConnection, bus: str) -> list[int]:
    """Return the keys of a bus and its units."""
    return [row[0] for row in connection.execute("SELECT id FROM unit WHERE bus = ?", (bus,))]


def name_of(connection: StoreConnection, unit: int) -> str:
    """Return ``bus/number`` of a unit's key."""
    row = connection.execute("SELECT bus, number FROM unit WHERE id = ?", (unit,)).fetchone()
    return "" if row is None else f"{row[0]}/{row[1]}"


def write_journal(connection: StoreConnection, rows: Sequence[tuple[int, PlainRun]]) -> None:
    """Write readings or runs of units as one row of the journal."""
    units, runs = zip(*sorted(rows, key=itemgetter(0)), strict=True)
    at, until, *rest = zip(*runs, strict=True)
    lengths = list(map(sub, until, at))
    data = pack_integers([units, at, lengths, *rest], _JOURNAL_LEVEL)
    newest = "SELECT coalesce(max(seq), 0) + 1, ? FROM journal"
    connection.execute(f"INSERT INTO journal (seq, data) {newest}", (data,))


def write_journal_again(connection: StoreConnection, rows: Sequence[tuple[int, PlainRun]]) -> None:
    """Replace the journal by these readings or runs."""
    connection.execute("DELETE FROM journal")
    if rows:
        write_journal(connection, rows)


def read_journal(connection: StoreConnection) -> Iterator[list[tuple[int, Run]] | None]:
    """Yield the readings of every row, oldest first; None for a damaged one."""
    for (data,) in connection.execute("SELECT data FROM journal ORDER BY seq"):
        try:
            units, at, lengths, *rest = unpack_integers(data)
        except ValueError:
            yield None
            continue
        until = [a + n for a, n in zip(at, lengths, strict=True)]
        yield list(zip(units, map(Run, at, until, *rest), strict=True))


def extent(connection: StoreConnection) -> tuple[int, int] | None:
    """Return the span of all stored data, µs; None if there is none."""
    rows = [
        connection.execute(f"SELECT min(start), max(start) FROM {name}").fetchone()
        for name in ("hours", "raw")
    ]
    spans = [row for row in rows if row[0] is not None]
    return (min(row[0] for row in spans), max(row[1] for row in spans) + DAY) if spans else None


def rollups_of(connection: StoreConnection, tier: RollupTier, unit: int, start: int) -> list[Rollup]:
    """Read one row of a tier; empty if there is none. Raise DamagedBlock."""
    query = f"SELECT data FROM {tier} WHERE unit = ? AND start = ?"
    row = connection.execute(query, (unit, start)).fetchone()
    return [] if row is None else intact(BlockKey(tier, unit, start), lambda: unpack_rollups(row[0], start))


def write_rollups(
    connection: StoreConnection, tier: RollupTier, unit: int, start: int, rows: Sequence[Rollup]
) -> None:
    """Write one row of a tier in place of a former one."""
    values = (unit, start, pack_rollups(rows, start))
    connection.execute(upsert(tier, ("unit", "start"), ("data",)), values)


def write_figures(connection: StoreConnection, unit: int, hour: int, data: bytes) -> None:
    """Write the figures of an hour in place of former ones."""
    connection.execute(upsert("figures", ("unit", "start"), ("data",)), (unit, hour, data))


def figures_between(
    connection: StoreConnection, bus: str, number: int, start: int, end: int
) -> list[tuple[int, bytes]]:
    """Return the figures of the hours of a unit that begin within a span, µs, in order of time; none from a
    store that an earlier version has left."""
    if not has_table(connection, "figures"):
        return []
    rows = connection.execute(
        "SELECT start, data FROM figures JOIN unit ON unit.id = figures.unit"
        " WHERE bus = ? AND number = ? AND start >= ? AND start < ? ORDER BY start",
        (bus, number, start, end),
    )
    return [(at, data) for at, data in rows]


def packed_units(connection: StoreConnection, bus: str, hour: int) -> dict[int, bytes | None]:
    """Return the units of a bus that have a packed hour, each with its figures, if they are stored."""
    rows = connection.execute(
        "SELECT number, figures.data FROM unit JOIN minutes ON minutes.unit = unit.id AND minutes.start = ?"
        " LEFT JOIN figures ON figures.unit = unit.id AND figures.start = minutes.start WHERE bus = ?",
        (hour, bus),
    )
    return dict(map(tuple, rows))


def write_raw(
    connection: StoreConnection, unit: int, start: int, span: int, table: Sequence[Sequence[int]]
) -> None:
    """Write a block of the columns of runs in place of all blocks in its span. It keeps the newest of their
    ids, because a reader who has read them has read it."""
    within = "FROM raw WHERE unit = ? AND start >= ? AND start < ?"
    place = (unit, start, start + span)
    [newest] = connection.execute(f"SELECT max(id) {within}", place).fetchone()
    connection.execute(f"DELETE {within}", place)
    number = newest or new_raw_ids(connection, 1)[0]
    connection.execute(INSERT_RAW, (*raw_row(unit, start, span, table), number))


def new_raw_ids(connection: StoreConnection, count: int) -> range:
    """Return ids for blocks that change. Ids only rise, even from one store to the one that replaces it, so
    that a reader that has seen the blocks up to an id finds everything that changed since behind it."""
    [last] = connection.execute(_RESERVE_IDS, {"count": count}).fetchone()
    return range(last - count + 1, last + 1)


def raw_row(
    unit: int, start: int, span: int, table: Sequence[Sequence[int]]
) -> tuple[int, int, int, int, bytes]:
    """Return the row of a block, without its id. Its ``points`` are those of a chart of single readings."""
    at, until, *_ = table
    return unit, start, span, len(at) + sum(map(gt, until, at)), pack_columns(table, start)


def raw_columns(connection: StoreConnection, unit: int, start: int, end: int) -> list[list[int]]:
    """Read the columns of all runs of the blocks that begin within a span, µs. Raise DamagedBlock."""
    rows = connection.execute(
        "SELECT start, data FROM raw WHERE unit = ? AND start >= ? AND start < ? ORDER BY start",
        (unit, start, end),
    )
    tables = [
        intact(
            BlockKey("raw", unit, begin),
            lambda data=data, begin=begin: unpack_columns(data, begin, Run._fields),  # type: ignore[misc]
        )
        for begin, data in rows
    ]
    return [list(chain.from_iterable(parts)) for parts in zip(*tables, strict=True)]


def block_runs(unit: int, start: int, data: bytes) -> list[Run]:
    """Unpack the runs of a block. Raise DamagedBlock."""
    return intact(BlockKey("raw", unit, start), lambda: unpack_runs(data, start))


def next_to_compact(connection: StoreConnection, before: int) -> tuple[int, int] | None:
    """Return a unit and an hour before a time that is still stored by minutes; None if there is none."""
    query = "SELECT unit, start FROM raw WHERE span = 60000000 AND start < ? ORDER BY start, unit LIMIT 1"
    row = connection.execute(query, (before,)).fetchone()
    return None if row is None else (row[0], row[1] - row[1] % HOUR)


def drop_raw(connection: StoreConnection, before: int, most: int) -> int:
    """Delete readings before a time, at most ``most`` blocks, the oldest first; return the number of blocks.
    An hour that is not packed has no rollups yet and stays a day longer."""
    return connection.execute(
        "DELETE FROM raw WHERE id IN (SELECT id FROM raw WHERE start < ?"
        " AND (span > 60000000 OR start < ?) ORDER BY start LIMIT ?)",
        (before, before - DAY, most),
    ).rowcount


def oldest_raw(connection: StoreConnection) -> int | None:
    """Return the start of the oldest block of any unit, µs."""
    row = connection.execute("SELECT min(start) FROM raw").fetchone()
    return None if row[0] is None else int(row[0])


def oldest_packed(connection: StoreConnection) -> int | None:
    """Return the start of the oldest packed hour of any unit, µs."""
    query = "SELECT start FROM raw WHERE span > 60000000 ORDER BY start LIMIT 1"
    row = connection.execute(query).fetchone()
    return None if row is None else int(row[0])


def newest_reading(connection: StoreConnection, unit: int) -> int | None:
    """Return the time of the newest stored reading of a unit, µs. Raise DamagedBlock."""
    query = "SELECT start, data FROM raw WHERE unit = ? ORDER BY start DESC LIMIT 1"
    row = connection.execute(query, (unit,)).fetchone()
    return None if row is None else max((run.until for run in block_runs(unit, *row)), default=None)


def rolled_up(connection: StoreConnection, unit: int, start: int, end: int) -> bool:
    """Return whether a unit has a minute of a packed hour within a span."""
    query = "SELECT 1 FROM minutes WHERE unit = ? AND start > ? AND start < ? LIMIT 1"
    return connection.execute(query, (unit, start - HOUR, end)).fetchone() is not None


def first_minute(connection: StoreConnection, unit: int) -> int | None:
    """Return the start of the oldest block of minutes of a unit, packed or not, µs."""
    query = "SELECT min(start) FROM {} WHERE unit = ?"
    found = [connection.execute(query.format(name), (unit,)).fetchone()[0] for name in ("minutes", "raw")]
    return min((start for start in found if start is not None), default=None)


def drop_rollups(connection: StoreConnection, before: int) -> None:
    """Delete rollups, bits and links before a time, µs."""
    connection.execute("DELETE FROM minutes WHERE start < ?", (before,))
    connection.execute("DELETE FROM hours WHERE start < ?", (before,))
    connection.execute("DELETE FROM figures WHERE start < ?", (before,))
    connection.execute("DELETE FROM bits WHERE until < ?", (before,))
    connection.execute("DELETE FROM link WHERE at < ?", (before,))
    connection.execute("DELETE FROM damaged WHERE found < ?", (before,))
    query = "DELETE FROM changed WHERE start < iif(kind = 'rest', ?, ?)"
    connection.execute(query, (before - DAY, raw_from(connection) - 2 * DAY))


def move_damaged(connection: StoreConnection, block: BlockKey, now: int) -> bool:
    """Move a block to the damaged ones; return False if it is gone or intact. ``now`` in µs."""
    where, key = f"FROM {block.tier} WHERE unit = ? AND start = ?", (block.unit, block.start)
    row = connection.execute(f"SELECT data {where}", key).fetchone()
    if row is None or sound(row[0]):
        return False
    values = (block.tier, *key, now, row[0])
    connection.execute("INSERT INTO damaged VALUES (?, ?, ?, ?, ?) ON CONFLICT DO NOTHING", values)
    connection.execute(f"DELETE {where}", key)
    return True


def note_replaced(connection: StoreConnection, file: str, now: int) -> None:
    """Note that this store is new, and that the damaged one before it is kept as ``file``; ``now`` in µs."""
    connection.execute("INSERT INTO damaged VALUES ('store', 0, 0, ?, ?)", (now, file.encode()))


def replaced_since(connection: StoreConnection, since: int) -> tuple[int, str] | None:
    """Return when this store was begun in place of a damaged one, and the name of that file; times in µs."""
    query = "SELECT found, data FROM damaged WHERE tier = 'store' AND found >= ? AND data IS NOT NULL"
    row = connection.execute(query, (since,)).fetchone()
    return None if row is None else (row[0], row[1].decode())


def damaged_since(connection: StoreConnection, since: int) -> int:
    """Count the damages that were found from a time on, µs."""
    return int(connection.execute("SELECT count(*) FROM damaged WHERE found >= ?", (since,)).fetchone()[0])


def bits_around(
    connection: StoreConnection, units: Iterable[int], start: int, end: int
) -> dict[int, list[Interval]]:
    """Read the intervals of each unit that touch a span (µs), and the neighbor on either side."""
    found: dict[int, list[Interval]] = {unit: [] for unit in units}
    rows = connection.execute(
        "WITH wanted (unit) AS (SELECT value FROM json_each(?)), bounds AS MATERIALIZED ("
        "SELECT unit,"
        " coalesce((SELECT max(at) FROM bits WHERE bits.unit = wanted.unit AND at < ?), ?) AS low,"
        " coalesce((SELECT min(at) FROM bits WHERE bits.unit = wanted.unit AND at >= ?), ?) AS high"
        " FROM wanted) "
        "SELECT bits.unit, at, until, word FROM bounds"
        " JOIN bits ON bits.unit = bounds.unit AND at >= low AND at <= high ORDER BY bits.unit, at",
        (json.dumps([*found]), start, start, end, end),
    )
    for unit, *interval in rows:
        found[unit].append(Interval(*interval))
    return found


def count_bits(connection: StoreConnection, unit: int, start: int, end: int) -> int:
    """Count the intervals that begin within a span."""
    query = "SELECT count(*) FROM bits WHERE unit = ? AND at >= ? AND at < ?"
    return int(connection.execute(query, (unit, start, end)).fetchone()[0])


def write_link(connection: StoreConnection, unit: int, at: int, state: str, cause: str) -> None:
    """Write that a unit or a port came into a state."""
    query = "INSERT INTO link VALUES (?, ?, ?, ?) ON CONFLICT DO NOTHING"
    connection.execute(query, (unit, at, state, cause))


_MARKED = "unit JOIN unit AS marked ON unit.bus = marked.bus AND marked.number IN (0, unit.number)"
"""A piece of SQL: each unit with itself and with its port, whose marks also count for its units."""


def link_marks(connection: StoreConnection, spans: Mapping[int, tuple[int, int]]) -> dict[int, Marks]:
    """Read when each unit or its port was lost and found within its span, µs."""
    rows = connection.execute(
        "WITH wanted (unit, since, until) AS (SELECT CAST(key AS INTEGER),"
        " json_extract(value, '$[0]'), json_extract(value, '$[1]') FROM json_each(?)) "
        "SELECT wanted.unit, link.at, link.state FROM wanted JOIN unit ON unit.id = wanted.unit"
        " JOIN unit AS marked ON marked.bus = unit.bus AND marked.number IN (0, unit.number)"
        " JOIN link ON link.unit = marked.id AND link.at >= wanted.since AND link.at <= wanted.until"
        " ORDER BY link.at",
        (json.dumps(dict(spans)),),
    )
    marks: dict[int, tuple[list[int], list[int]]] = {}
    for unit, at, state in rows:
        marks.setdefault(unit, ([], []))[state not in LOST_STATES].append(at)
    return {unit: Marks(*marks.get(unit, ((), ()))) for unit in spans}


def marks_since(connection: StoreConnection, start: int) -> list[tuple[int, int]]:
    """Return the units that were lost or found from a time on, on their own or with their port, and when, in
    µs."""
    query = f"SELECT unit.id, at FROM {_MARKED} JOIN link ON link.unit = marked.id WHERE at >= ?"
    return [(row[0], row[1]) for row in connection.execute(query, (start,))]


def lost_between(
    connection: StoreConnection, start: int, end: int, unit: int | None = None
) -> list[tuple[int, int, str]]:
    """Return when units or their ports were lost within a span, µs, and the states that they came into; for
    one unit, or for all."""
    states = ", ".join("?" * len(LOST_STATES))
    query = (
        f"SELECT unit.id, link.at, link.state FROM {_MARKED} JOIN link ON link.unit = marked.id"
        " WHERE unit.number > 0 AND (unit.id = ? OR ? IS NULL) AND link.at >= ? AND link.at < ?"
        f" AND link.state IN ({states})"
    )
    return [*map(tuple, connection.execute(query, (unit, unit, start, end, *LOST_STATES)))]


def write_parameter(connection: StoreConnection, unit: int, step: ParameterStep) -> None:
    """Write a value of a scaling parameter that was read."""
    query = upsert("parameter", ("unit", "number", "at"), ("raw",))
    connection.execute(query, (unit, step.number, step.at, step.raw))


def parameter_steps(connection: StoreConnection, unit: int) -> list[ParameterStep]:
    """Return all values that the scaling parameters of a unit ever had, oldest first."""
    rows = connection.execute("SELECT at, number, raw FROM parameter WHERE unit = ? ORDER BY at", (unit,))
    return [ParameterStep(*row) for row in rows]


def raw_from(connection: StoreConnection) -> int:
    """Return the time before which readings were given up, µs; 0 if none were."""
    row = connection.execute("SELECT value FROM fact WHERE name = 'raw_from'").fetchone()
    return 0 if row is None else int(row[0])


def write_raw_from(connection: StoreConnection, at: int) -> None:
    """Give up the readings before a time, µs."""
    connection.execute(upsert("fact", ("name",), ("value",)), ("raw_from", at))


def correct_raw_from(connection: StoreConnection, now: int) -> None:
    """Undo giving up readings until a time in the future, which a wrong clock has caused; ``now`` in µs."""
    at = raw_from(connection)
    write_raw_from(connection, 0 if at > now else at)
