"""The writer's thread commits, ends in order, and reports and survives a bad or full disk."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path

import pytest

from app.errors import StoreError
from app.line.history import tables
from app.line.history.query import SeriesQuery, run_query
from app.line.history.series.runs import micros
from app.line.history.series.values import VALUES
from app.line.history.status import DiskReserve, StoreState, space
from app.line.history.writer import Writer
from tests.app.history_line import BUS, NOON, Shelf, opened, parameter, polls, until

ENDLESS = 10**18
LONG_AGO = NOON - 1000 * 86_400


def test_what_was_taken_in_is_there_after_the_end(tmp_path: Path) -> None:
    writer = opened(tmp_path)
    writer.enqueue((BUS.name, [parameter(3, 0), *polls(NOON, NOON + 90)]))
    writer.close()
    shelf = Shelf(tmp_path / "history.db")
    assert shelf.tail.everything() == []
    assert len(shelf.query("actual", NOON, NOON + 90).series.at) == 450
    shelf.close()


def test_readers_see_readings_soon(tmp_path: Path) -> None:
    writer = opened(tmp_path)
    writer.enqueue((BUS.name, polls(NOON, NOON + 10)))
    until(lambda: writer.status.waiting == 0)
    assert readings_of(writer) == 50
    writer.close()


def test_what_cannot_be_written_waits_and_the_oldest_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.line.history.writer.MAX_WAITING", 100)
    (tmp_path / "history.db").mkdir()
    writer = opened(tmp_path)
    for second in range(40):
        writer.enqueue((BUS.name, polls(NOON + second, NOON + second + 1)))
    assert (writer.status.waiting, writer.status.lost) == (100, 100)
    assert writer.status.state == "failed"
    writer.close()


def test_a_nearly_full_disk_is_announced_and_the_oldest_readings_go_first(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "history.db")
    now = time.time()
    old, recent = (polls(start, start + 20) for start in (LONG_AGO, now - 60))
    for readings in (old, recent):
        shelf.keep(readings)
    shelf.fold()
    shelf.close()
    writer = opened(tmp_path, DiskReserve(announce=ENDLESS, trim=ENDLESS, pause=0))
    until(lambda: writer.status.state == "scarce")
    until(lambda: (writer.database.read_now(tables.oldest_raw) or 0) > micros(now - 200))
    assert "nearly full" in str(writer.status.message)
    minutes = writer.database.read_now(lambda c: c.execute("SELECT count(*) FROM minutes").fetchone()[0])
    assert minutes == 1, "those of the old hour stay; the last hour has its readings"
    writer.close()


def test_a_full_disk_pauses_history_for_the_sake_of_events(tmp_path: Path) -> None:
    writer = opened(tmp_path, DiskReserve(ENDLESS, ENDLESS, ENDLESS))
    until(lambda: writer.status.state == "paused")
    writer.enqueue((BUS.name, polls(NOON, NOON + 10)))
    until(lambda: writer.status.free_bytes > 0)
    assert (writer.status.waiting, writer.tail.everything()) == (50, [])
    writer.close()


def test_a_disk_that_fails_while_running_is_reported_and_stored_values_stay_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.line.history.writer.RETRY_S", 0.0)
    writer = opened(tmp_path)
    writer.enqueue((BUS.name, polls(NOON, NOON + 10)))
    until(lambda: writer.status.waiting == 0)
    with monkeypatch.context() as failing:
        failing.setattr(tables, "write_journal", _full)
        failing.setattr(tables, "write_raw_from", _full)
        writer.enqueue((BUS.name, polls(NOON + 10, NOON + 20)))
        until(lambda: writer.status.state == "failed")
        assert "the disk is full" in str(writer.status.cause)
        assert writer.status.waiting == 50
        assert readings_of(writer) == 50
    until(lambda: writer.status.state == "ok")
    until(lambda: writer.status.waiting == 0)
    assert readings_of(writer) == 100
    writer.close()


def _full(*_: object) -> None:
    error = sqlite3.OperationalError("database or disk is full")
    error.sqlite_errorcode = sqlite3.SQLITE_FULL
    raise error


def readings_of(writer: Writer) -> int:
    query = SeriesQuery(BUS, 1, VALUES["actual"], micros(NOON), micros(NOON + 60), 1000)
    found = writer.database.read_now(lambda connection: run_query(connection, writer.tail, query))
    return len(found.series.at)


@pytest.mark.parametrize("content", [b"not a store at all, but long enough to be taken for one" * 100])
def test_a_damaged_store_is_reported_and_nothing_else_fails(
    tmp_path: Path, content: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The first commit would replace the store.
    monkeypatch.setattr("app.line.history.writer.COMMIT_EVERY_S", 3600.0)
    (tmp_path / "history.db").write_bytes(content)
    writer = opened(tmp_path)
    assert writer.status.state == "failed"
    assert "history.db" in str(writer.status.message)
    writer.enqueue((BUS.name, polls(NOON, NOON + 10)))
    with pytest.raises(StoreError, match="no history is stored"):
        _ = writer.database
    writer.close()
    assert (tmp_path / "history.db").read_bytes() == content


def test_a_store_of_a_newer_version_is_refused_in_words(tmp_path: Path) -> None:
    opened(tmp_path).close()
    with sqlite3.connect(tmp_path / "history.db") as connection:
        connection.execute("INSERT INTO migrations VALUES (9999, 'later', 0)")
    writer = opened(tmp_path)
    assert "newer version" in str(writer.status.message)
    writer.close()


RESERVE = DiskReserve(announce=1000, trim=500, pause=100)


@pytest.mark.parametrize(
    ("free", "meaning"),
    [(5000, "ok"), (1000, "ok"), (999, "low"), (500, "low"), (499, "scarce"), (99, "paused"), (0, "paused")],
)
def test_less_free_space_means_a_stricter_state(free: int, meaning: StoreState) -> None:
    assert space(free, RESERVE) == meaning
