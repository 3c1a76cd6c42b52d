"""The backlog of an edge node: unsent spans of the history, by unit, kept in the main store.

The history is the outbox: nothing is stored a second time. Times are in µs since the epoch.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.line.history.query import runs_between, stored_unit
from app.line.history.recorder import Tail
from app.line.history.series.runs import MINUTE, SECOND
from app.line.history.series.values import united
from app.system.postgresql.outbox import HistoryRows
from app.system.postgresql.rows import READING, points_of, reading_rows
from app.system.tags import Value
from bus.instants import UnixTime
from bus.settings import BusSettings

MAX_BD_SEQ = 256
PIECE = 5 * MINUTE
"""The span of one unit that is read at a time: a thousand readings or two."""
_COLUMNS = READING.columns[3:-1]
Row = tuple[UnixTime, Mapping[str, Value]]


@dataclass
class Backlog:
    """The spans of a bus's history that the broker has not received. ``bd_seq``: the number of the last
    connection (Sparkplug 3.0, 6.4.20); ``received``: all readings up to this time were received, except for
    the spans."""

    bus: str
    bd_seq: int = -1
    received: int = 0
    spans: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def connect(self) -> int:
        """Return the number of the next connection."""
        self.bd_seq = (self.bd_seq + 1) % MAX_BD_SEQ
        return self.bd_seq

    def add(self, start: int, ends: Mapping[int, int], oldest: int) -> None:
        """Add an unsent span, from ``start`` to the end for each unit. Spans older than ``oldest`` are given
        up."""
        for unit, end in ends.items():
            self.spans[unit].append((start, end))
        self.spans = {
            unit: united((max(start, oldest), end) for start, end in spans if end > max(start, oldest))
            for unit, spans in self.spans.items()
        }

    def next_piece(self, units: set[int]) -> tuple[int, tuple[int, int]] | None:
        """Return the oldest piece to send of these units; None if there is none."""
        waiting = [(spans[0], unit) for unit, spans in self.spans.items() if spans and unit in units]
        if not waiting:
            return None
        (start, until), unit = min(waiting)
        return unit, (start, min(until, start + PIECE))

    def sent(self, unit: int, until: int) -> None:
        """Note that a piece was sent up to ``until``."""
        _, end = self.spans[unit][0]
        self.spans[unit][:1] = [(until, end)] if until < end else []

    def waiting_s(self) -> float:
        """Return the seconds of waiting readings, for the unit with the most."""
        return max((sum(end - start for start, end in spans) for spans in self.spans.values()), default=0) / (
            SECOND
        )


def read_backlog(connection: StoreConnection, bus: BusSettings) -> Backlog:
    """Return the stored backlog of a bus, for its present units."""
    query = "SELECT bd_seq, received FROM mqtt_node WHERE bus = ?"
    bd_seq, received = connection.execute(query, (bus.name,)).fetchone() or (-1, 0)
    found = Backlog(bus.name, bd_seq, received, {unit.id: [] for unit in bus.unit})
    query = "SELECT unit, start, until FROM mqtt_unsent WHERE bus = ? ORDER BY unit, start"
    for unit, start, until in connection.execute(query, (bus.name,)):
        if unit in found.spans:
            found.spans[unit].append((start, until))
    return found


def write_backlog(connection: StoreConnection, backlog: Backlog) -> None:
    """Store the backlog of a bus."""
    row = (backlog.bus, backlog.bd_seq, backlog.received)
    connection.execute(upsert("mqtt_node", ("bus",), ("bd_seq", "received")), row)
    connection.execute("DELETE FROM mqtt_unsent WHERE bus = ?", (backlog.bus,))
    rows = [(backlog.bus, unit, *span) for unit, spans in backlog.spans.items() for span in spans]
    connection.executemany("INSERT INTO mqtt_unsent VALUES (?, ?, ?, ?)", rows)


class PastReadings:
    """A reader of past readings of a bus from its history, in engineering units."""

    def __init__(self, bus: BusSettings) -> None:
        self._bus = bus
        self._rows = HistoryRows((bus,), 0)

    def read(self, connection: StoreConnection, tail: Tail, unit: int, span: tuple[int, int]) -> list[Row]:
        """Return the first and the last of equal readings of a unit in a span."""
        start, end = span
        known = next((each for each in self._rows.units(connection).values() if each.number == unit), None)
        if known is None:
            return []
        source = stored_unit(connection, tail, *known.place, start - MINUTE, end + MINUTE)
        if source is None:
            return []
        runs = runs_between(source, start - MINUTE, end + MINUTE)
        points = [(at, run) for at, run in points_of(runs) if start <= at < end]
        return list(_rows(reading_rows(known.place, points, known.scales, self._bus.estop_healthy)))


def _rows(rows: Iterator[tuple[object, ...]]) -> Iterator[Row]:
    for at, _, _, *values, _ in rows:
        yield UnixTime(at.timestamp()), dict(zip(_COLUMNS, values, strict=True))  # type: ignore[attr-defined,arg-type]
