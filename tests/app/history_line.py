"""A line of one unit for the tests of history: a store in a folder, readings at chosen times, queries."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from unittest.mock import patch

from app.core.database import Database
from app.line.history import tables, writer
from app.line.history.query import QueryResult, SeriesQuery, run_query
from app.line.history.recorder import Recorder, Tail, compact
from app.line.history.series.runs import HOUR, micros
from app.line.history.series.values import VALUES
from app.line.history.settings import HistorySettings
from app.line.history.status import DiskReserve
from app.line.history.writer import MIGRATIONS, Upkeep, Writer
from bus.contract import ParameterValue, Reading, Update
from bus.instants import Monotonic
from bus.messages import Message
from bus.settings import BusSettings, UnitSettings

BUS = BusSettings(name="dry-end", port="/dev/null", unit=(UnitSettings(id=1, name="Unwind"),))
NOON = 1_795_262_400.0
"""2026-11-21T12:00:00Z."""


def reading(
    at: float, actual: int = 1000, *, unit: int = 1, inputs: int = 0b11, outputs: int = 0xC0
) -> Reading:
    """Return one response to 81h."""
    return Reading(unit, at, 1000, actual, 51, outputs, inputs)


def parameter(number: int, raw: int, at: float = NOON - 86_400, unit: int = 1) -> ParameterValue:
    """Return one response to 85h."""
    return ParameterValue(unit, number, at, raw)


def polls(start: float, end: float, value: Callable[[int], int] = lambda i: 1000 + i % 7) -> list[Update]:
    """Return five readings a second."""
    count = round((end - start) * 5)
    return [reading(start + i / 5, value(i)) for i in range(count)]


class Shelf:
    """A store and its tail, written by the test itself."""

    def __init__(self, path: Path) -> None:
        self.database = Database(path, MIGRATIONS)
        self.tail = Tail()
        self.start_again()

    def start_again(self) -> None:
        """As after a crash: what is not on disk is gone."""
        self.recorder = Recorder(self.database, self.tail, lambda _: None)
        self.recorder.replay()

    def keep(self, updates: Iterable[Update]) -> None:
        """On disk in the journal, and in the tail."""
        self.recorder.commit([(BUS.name, list(updates))])

    def fold(self) -> None:
        """Every minute into its block."""
        self.recorder.fold_everything()

    def pack(self) -> None:
        """Every hour into its block."""
        while found := self.database.read_now(lambda c: tables.next_to_compact(c, 2**62)):
            self.database.write_now(lambda c, found=found: compact(c, *found))  # type: ignore[misc]

    def work_out(self, bus: BusSettings) -> None:
        """The figures of every packed hour of a bus."""
        with patch.object(writer, "FIGURES_EVERY_S", 0.0):
            upkeep = Upkeep(self.database, HistorySettings(), DiskReserve(), lambda _: None, [bus])
            upkeep.work_out(micros(NOON) + 3 * HOUR, Monotonic(math.inf))

    def query(
        self, value: str, start: float, end: float, most: int = 20_000, bus: BusSettings = BUS
    ) -> QueryResult:
        """What a value was."""
        query = SeriesQuery(bus, 1, VALUES[value], micros(start), micros(end), most)
        return self.database.read_now(lambda connection: run_query(connection, self.tail, query))

    def close(self) -> None:
        """The journal keeps what is in the tail."""
        self.database.close()


def opened(
    folder: Path,
    reserve: DiskReserve | None = None,
    on_damage: Callable[[Message], None] = lambda _what: None,
) -> Writer:
    """A writer with its thread."""
    made = Writer(folder / "history.db", HistorySettings(), lambda _kind, what: on_damage(what), reserve)
    made.start()
    return made


def until(condition: Callable[[], bool], patience_s: float = 30.0) -> None:
    """Wait for another thread."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, "the writer did not get there"
        time.sleep(0.01)
