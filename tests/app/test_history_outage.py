"""History while its database is away: readings wait on the disk, follow in order, and are there once."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.database.settings import StoreSettings
from app.history.intake.share import StoreShare
from app.history.intake.writer import Writer
from app.history.series.runs import Run
from app.history.spool.follower import Follower
from app.history.spool.spool import Spool
from app.history.status import store_notice
from app.history.store import tables
from app.web.rendering.formats import Formats
from bus.contract import UnitLink
from bus.instants import Monotonic
from bus.messages import Message
from tests.app.away_history import quickly, stored_in, writer_of
from tests.app.history_line import BUS, NOON, Shelf, parameter, polls, reading, until
from tests.postgresql import fresh_database, url_of
from tests.stores import ENGINES

ENDLESS = 10**18
FORMATS = Formats("en_GB")


class Site:
    """A server with its database, which a test makes unreachable."""

    def __init__(self, folder: Path, store: StoreSettings | None) -> None:
        self.folder, self.store = folder, store
        self.events: list[Message] = []
        self.writers: list[Writer] = []

    @contextlib.contextmanager
    def without_database(self) -> Iterator[None]:
        """Connections are refused, and those that are open end."""
        (self.folder / "away").touch()
        self._allow(False)
        try:
            yield
        finally:
            self._allow(True)
            (self.folder / "away").unlink()

    def start(self, server: str = "a", most: int = 1_000_000) -> Writer:
        share = StoreShare(server, (BUS.name,))
        store = self.store or StoreSettings()
        folder = self.folder / server
        folder.mkdir(exist_ok=True)
        self.writers.append(writer_of(folder, self.events.append, store=store, share=share, most=most))
        return self.writers[-1]

    def codes(self) -> list[str]:
        return [event.code for event in self.events]

    def _allow(self, allowed: bool) -> None:
        if self.store is None:
            return
        import psycopg

        name = psycopg.conninfo.conninfo_to_dict(self.store.url)["dbname"]
        with psycopg.connect(url_of("postgres"), autocommit=True) as server:
            server.execute(f'ALTER DATABASE "{name}" ALLOW_CONNECTIONS {allowed}'.encode())
            if not allowed:
                server.execute(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", (name,)
                )


@pytest.fixture(params=ENGINES)
def site(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    with contextlib.ExitStack() as stack:
        is_file = request.param == "sqlite"
        store = None if is_file else stack.enter_context(fresh_database())
        stack.enter_context(quickly(monkeypatch, tmp_path if is_file else None))
        site = Site(tmp_path, store)
        yield site
        for writer in site.writers:
            writer.close()


def take(writer: Writer, start: float, end: float) -> None:
    """Readings that are on a disk when this returns."""
    writer.take((BUS.name, polls(start, end)))
    until(lambda: writer.status.waiting == 0)


def test_what_came_while_the_database_was_away_follows_and_is_there_once(site: Site) -> None:
    writer = site.start()
    take(writer, NOON, NOON + 30)
    with site.without_database():
        before = time.time()
        writer.take((BUS.name, [UnitLink(1, NOON + 200, "stale"), parameter(3, 1, NOON + 100)]))
        for minute in range(1, 6):
            take(writer, NOON + minute * 60, NOON + minute * 60 + 30)
        status = writer.status
        assert (status.state, status.spooled_readings) == ("spooling", 5 * 150)
        assert (status.spooled_from, status.spooled_to) == (NOON + 60, NOON + 329.8)
        assert 0 < status.spooled_bytes < 20_000
        assert before - 10 < (status.away_since or 0) <= time.time()
        shown = str(store_notice(status, FORMATS, time.time()))
        assert "750 readings from" in shown
        assert "trends are missing" in shown
    until(lambda: writer.status.away_since is None)
    take(writer, NOON + 400, NOON + 430)
    until(lambda: not writer.status.spooled_readings)
    until(lambda: writer.status.state == "ok")
    assert (writer.status.away_since, writer.status.spooled_from) == (None, None)
    found = stored_in(writer, NOON, NOON + 600)
    assert sum(run.readings for run in found) == 7 * 150
    assert [run.at for run in found] == sorted({run.at for run in found})
    assert site.codes() == ["event_history_spooling", "event_history_follows", "event_history_followed"]
    assert site.events[1].params["count"] == 750
    steps = writer.database.read_now(lambda c: tables.parameter_steps(c, tables.units_of(c, BUS.name)[0]))
    assert [(step.number, step.raw) for step in steps] == [(3, 1)]


def test_a_server_that_ends_while_its_database_is_away_loses_nothing(site: Site) -> None:
    writer = site.start()
    take(writer, NOON, NOON + 30)
    with site.without_database():
        take(writer, NOON + 60, NOON + 90)
        # Not waited for: the end itself brings it to the disk.
        writer.take((BUS.name, polls(NOON + 120, NOON + 150)))
        writer.close()
        assert site.codes() == ["event_history_spooling"]
        site.writers.clear()
        again = site.start()
        take(again, NOON + 180, NOON + 210)
        assert again.status.spooled_readings == 450
    until(lambda: again.status.state == "ok")
    assert sum(run.readings for run in stored_in(again, NOON, NOON + 600)) == 600


def test_a_full_spool_gives_up_the_oldest_and_reports_it(site: Site) -> None:
    writer = site.start(most=6_000)
    with site.without_database():
        for minute in range(100):
            take(writer, NOON + minute * 60, NOON + minute * 60 + 30)
        status = writer.status
        assert status.spooled_bytes <= 6_000
        assert status.spool_lost + status.spooled_readings == 100 * 150
        assert status.spooled_to == NOON + 99 * 60 + 29.8
        assert f"{status.spool_lost} older readings are lost" in str(
            store_notice(status, FORMATS, time.time())
        )
    until(lambda: "event_history_followed" in site.codes())
    assert site.codes().count("event_history_spool_full") == 1
    assert site.events[-1].params == {"lost": status.spool_lost}
    found = stored_in(writer, NOON, NOON + 6000)
    assert sum(run.readings for run in found) == status.spooled_readings
    assert writer.status.spool_lost == 0


def test_a_commit_whose_result_was_lost_is_not_counted_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with quickly(monkeypatch, tmp_path):
        writer = writer_of(tmp_path)
        take(writer, NOON, NOON + 30)
        (tmp_path / "mute").touch()
        writer.take((BUS.name, [reading(NOON + 40 + i / 5) for i in range(50)]))
        until(lambda: writer.status.state == "spooling" and writer.status.waiting == 0)
        # Equal to those before, so that they would make one run with them.
        writer.take((BUS.name, [reading(NOON + 50 + i / 5) for i in range(50)]))
        until(lambda: writer.status.waiting == 0)
        (tmp_path / "mute").unlink()
        until(lambda: writer.status.state == "ok" and not writer.status.spooled_readings)
        writer.close()
    shelf = Shelf(tmp_path / "history.db")
    assert sum(run.readings for run in _runs(shelf)) == 250
    shelf.close()


def _runs(shelf: Shelf) -> list[Run]:
    return shelf.database.read_now(lambda c: tables.raw_between(c, tables.units_of(c, BUS.name)[0], 0, 2**62))


def test_following_gives_way_to_the_next_commit(tmp_path: Path) -> None:

    spool = Spool(tmp_path / "spool", 10**6)
    spool.append([(BUS.name, polls(NOON, NOON + 10))])
    spool.close()
    shelf = Shelf(tmp_path / "history.db")
    follower = Follower(shelf.database, spool, lambda _: None, 0)
    follower.follow(Monotonic(0.0))
    assert spool.contents.readings == 50
    shelf.close()


def test_an_older_value_of_a_parameter_counts_before_the_newer_one(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "history.db")
    shelf.keep([parameter(3, 0, NOON), *polls(NOON, NOON + 30)])
    shelf.keep([parameter(3, 2, NOON + 20)])
    shelf.keep([parameter(3, 1, NOON + 10)])
    found = shelf.query("actual", NOON, NOON + 30).series.average
    assert (found[0], found[60], found[120]) == (1000.0, 100.4, 10.01)
    shelf.close()


@pytest.fixture
def unfolded(monkeypatch: pytest.MonkeyPatch) -> None:
    """No minute is over."""
    monkeypatch.setattr("app.history.intake.recorder.GRACE", ENDLESS)


shared = pytest.mark.parametrize("site", ENGINES[1:], indirect=True)


@shared
@pytest.mark.usefixtures("unfolded")
def test_two_servers_write_into_one_store_and_keep_to_their_own_journal(site: Site) -> None:
    first, second = site.start("a"), site.start("b")
    take(first, NOON, NOON + 30)
    second.take(("wet-end", polls(NOON, NOON + 30)))
    until(lambda: second.status.waiting == 0)
    assert (len(first.tail), len(second.tail)) == (150, 150)
    first.close()
    site.writers.remove(first)
    again = site.start("a")
    until(lambda: again.status.state == "ok")
    count = "SELECT count(*) FROM journal"
    assert second.database.read_now(lambda c: c.execute(count).fetchone()[0]) == 1


@shared
@pytest.mark.usefixtures("unfolded")
def test_a_new_home_stores_what_the_former_one_had_only_in_its_journal(site: Site) -> None:
    first = site.start("a")
    take(first, NOON, NOON + 30)
    second = site.start("b")
    assert not _blocks(second)
    second.adopt(BUS.name)
    until(lambda: _blocks(second) == 150)
    # The first one comes back, with the same in its journal.
    first.close()
    site.writers.remove(first)
    assert _blocks(second) == 150


def _blocks(writer: Writer) -> int:
    """The readings of unit 1 in blocks."""

    def read(connection: tables.StoreConnection) -> int:
        keys = tables.units_of(connection, BUS.name)
        return sum(run.readings for key in keys for run in tables.raw_between(connection, key, 0, 2**62))

    return writer.database.read_now(read)
