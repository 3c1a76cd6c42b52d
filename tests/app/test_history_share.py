"""Several servers write into one store of history: each keeps to its buses, and one gives up what is old."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.database import StoreConnection
from app.database.engine import durable
from app.database.opening import open_database
from app.history.intake.opening import MIGRATIONS
from app.history.intake.share import StoreShare
from app.history.intake.upkeep import DiskReserve, Upkeep
from app.history.series.runs import DAY, micros
from app.history.settings import HistorySettings
from app.history.store import tables
from bus.instants import Monotonic
from tests.app.history_line import NOON, Shelf, polls
from tests.postgresql import fresh_database, needs_postgresql
from tests.stores import both_engines

NOW = micros(NOON + 86_400)
ENDLESS = Monotonic(math.inf)


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf]:
    """Two minutes of two buses."""
    shelf = Shelf(tmp_path / "history.db")
    for bus in ("dry-end", "wet-end"):
        shelf.recorder.commit([(bus, polls(NOON, NOON + 120))])
    shelf.fold()
    yield shelf
    shelf.close()


def upkeep(shelf: Shelf, *homes: str) -> Upkeep:
    share = StoreShare("a", ("dry-end", "wet-end"), homes.__contains__)
    kept = Upkeep(shelf.database, HistorySettings(raw_days=1), DiskReserve(), lambda _: None, share)
    kept._settled_at = Monotonic(-math.inf)
    return kept


def spans(connection: StoreConnection) -> list[tuple[str, int]]:
    query = "SELECT bus, span FROM raw JOIN unit ON unit.id = raw.unit ORDER BY bus, start"
    return [(bus, span // 60_000_000) for bus, span in connection.execute(query)]


@both_engines
def test_hours_are_packed_by_the_home_of_their_bus(shelf: Shelf) -> None:
    minutes = [("dry-end", 1), ("dry-end", 1), ("wet-end", 1), ("wet-end", 1)]
    upkeep(shelf).compact(NOW, ENDLESS)
    assert shelf.database.read_now(spans) == minutes
    upkeep(shelf, "wet-end").compact(NOW, ENDLESS)
    assert shelf.database.read_now(spans) == [*minutes[:2], ("wet-end", 60)]


def test_old_readings_of_every_bus_are_given_up_by_the_home_of_the_site(shelf: Shelf) -> None:
    other, site = upkeep(shelf, "dry-end", "wet-end"), upkeep(shelf, "")
    for server, left in ((other, 4), (site, 0)):
        server.give_up_old(NOW + 3 * DAY)
        server.sweep(ENDLESS)
        assert len(shelf.database.read_now(spans)) == left


@both_engines
def test_journals_of_servers_are_apart_and_the_first_has_that_of_one_server_alone(shelf: Shelf) -> None:
    write = shelf.database.write_now
    assert write(lambda c: [tables.journal_of(c, server) for server in "aba"]) == [0, tables.JOURNAL_ROWS, 0]


@needs_postgresql
def test_only_what_a_spool_drops_afterwards_waits_for_the_disk_of_the_database() -> None:
    shown = "SELECT current_setting('synchronous_commit')"
    with fresh_database() as settings:
        database = open_database(settings, Path("history.db"), MIGRATIONS, "NORMAL")

        def waits(connection: StoreConnection) -> list[str]:
            before = connection.execute(shown).fetchone()[0]
            durable(connection)
            return [before, connection.execute(shown).fetchone()[0]]

        assert database.write_now(waits) == ["off", "on"]
        assert database.write_now(waits) == ["off", "on"]
        database.close()
