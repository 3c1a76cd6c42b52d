"""The store of history: readings are found, on time or late, after a crash, and a bad or full disk is
survived."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from msgspec.structs import replace

from app.line.history import query, tables
from app.line.history.query import SeriesQuery, StoredUnit, run_query
from app.line.history.recorder import compact
from app.line.history.series.figures import Points
from app.line.history.series.runs import HOUR, micros
from app.line.history.series.values import VALUES
from app.line.history.settings import HistorySettings
from app.line.history.status import DiskReserve, StoreState, space
from app.line.history.writer import SETTLED_S, Upkeep, Writer
from bus.contract import BusLink, UnitLink
from tests.app.history_line import BUS, NOON, Shelf, opened, parameter, polls, reading, until

YEAR = 365 * 86_400.0


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf]:
    shelf = Shelf(tmp_path / "history.db")
    yield shelf
    shelf.close()


def test_readings_are_found_before_and_after_they_are_folded(shelf: Shelf) -> None:
    shelf.keep([parameter(3, 1), *polls(NOON, NOON + 60)])
    for _ in range(2):
        found = shelf.query("actual", NOON, NOON + 60)
        assert (found.resolution, found.bucket, found.decimals) == ("readings", 0, 1)
        assert found.series.least == found.series.greatest == found.series.average
        assert found.series.average == [(1000 + i % 7) / 10 for i in range(300)]
        assert found.series.at == [micros(NOON + i / 5) for i in range(300)]
        shelf.fold()


def test_an_idle_line_costs_little_and_is_no_hole(shelf: Shelf) -> None:
    shelf.keep(polls(NOON, NOON + 300, lambda _: 1000))
    shelf.fold()
    rows = shelf.database.read_now(lambda c: c.execute("SELECT sum(points) FROM raw").fetchone()[0])
    assert rows <= 2 * 6
    found = shelf.query("actual", NOON + 30, NOON + 200)
    assert set(found.series.average) == {1000.0}
    assert (found.series.at[0], found.series.at[-1]) == (micros(NOON + 30), micros(NOON + 200))


def test_a_unit_that_stopped_responding_leaves_a_gap(shelf: Shelf) -> None:
    shelf.keep(polls(NOON, NOON + 10, lambda _: 1000))
    shelf.keep([UnitLink(1, NOON + 11, "stale")])
    shelf.keep(polls(NOON + 13, NOON + 20, lambda _: 1000))
    for _ in range(2):
        found = shelf.query("actual", NOON, NOON + 20)
        place = found.series.average.index(None)
        assert found.series.average == [1000.0, 1000.0, None, 1000.0, 1000.0]
        assert micros(NOON + 9) < found.series.at[place] < micros(NOON + 13)
        assert shelf.query("run", NOON, NOON + 20).series.average == [1.0, 1.0, None, 1.0, 1.0]
        shelf.fold()


def test_a_closed_port_leaves_a_hole_in_every_unit(shelf: Shelf) -> None:
    shelf.keep([BusLink(NOON - 1, "open"), *polls(NOON, NOON + 10)])
    shelf.keep([BusLink(NOON + 11, "closed", "unplugged")])
    shelf.keep(polls(NOON + 12, NOON + 20))
    assert shelf.query("actual", NOON, NOON + 20).series.average.count(None) == 1


def test_another_rate_of_an_open_port_leaves_none(shelf: Shelf) -> None:
    shelf.keep([BusLink(NOON - 1, "open", baud=9600), *polls(NOON, NOON + 10)])
    shelf.keep([BusLink(NOON - 1, "open", baud=4800), *polls(NOON + 10, NOON + 20)])
    assert shelf.query("actual", NOON, NOON + 20).series.average.count(None) == 0
    stored = shelf.database.read_now(lambda c: c.execute("SELECT count(*) FROM link").fetchone()[0])
    assert stored == 1


def test_a_unit_lost_and_back_within_one_commit_leaves_a_hole(shelf: Shelf) -> None:
    before, after = polls(NOON, NOON + 5, lambda _: 1000), polls(NOON + 6, NOON + 10, lambda _: 1000)
    shelf.keep([*before, UnitLink(1, NOON + 5.5, "stale"), UnitLink(1, NOON + 6, "online"), *after])
    assert shelf.query("actual", NOON, NOON + 10).series.average.count(None) == 1


def test_readings_that_the_manual_rules_out_leave_a_hole_and_a_mark_a_second(shelf: Shelf) -> None:
    """A unit that turns around 0: its speed is now 0, now that of a negative number."""
    for start in (NOON, NOON + 20):
        shelf.keep(polls(start, start + 5, lambda _: 0))
        shelf.keep(
            [replace(reading(start + 5 + i / 5, 0), actual=None, implausible=b"\xff") for i in range(9)]
        )
        shelf.keep(polls(start + 6.8, start + 10, lambda _: 0))
    for _ in range(2):
        for value in ("actual", "analog", "run"):
            found = shelf.query(value, NOON, NOON + 10).series
            gaps = [found.at[i] for i, each in enumerate(found.average) if each is None]
            assert [micros(NOON + 4.8) < at < micros(NOON + 6.8) for at in gaps] == [True]
        shelf.fold()
    marks = shelf.database.read_now(lambda c: tables.lost_between(c, 0, micros(NOON + 60)))
    assert [(at - micros(NOON), state) for _, at, state in marks] == [
        (each * 1_000_000, "implausible") for each in (5, 6, 25, 26)
    ]


@pytest.mark.parametrize("value", ["actual", "run"])
def test_a_server_killed_and_started_again_at_once_leaves_a_hole(shelf: Shelf, value: str) -> None:
    """A second, within one minute, of a value that never changes: no process was there to record it."""
    for start in (NOON, NOON + 11, NOON + 21):
        shelf.keep([BusLink(start - 0.04, "open"), UnitLink(1, start, "online")])
        shelf.keep(polls(start, NOON + 10 * ((start - NOON) // 10 + 1), lambda _: 1000))
        shelf.start_again()
    for _ in range(2):
        found = shelf.query(value, NOON, NOON + 30).series
        assert [i for i, v in enumerate(found.average) if v is None] == [2, 5]
        assert [found.at[i] // 1_000_000 - int(NOON) for i in (2, 5)] == [10, 20]
        shelf.fold()


def test_journals_of_several_servers_are_taken_up_in_a_store_that_came_back(shelf: Shelf) -> None:
    """Each server of a site in PostgreSQL had the rows of its journal from 2**40 times its number on."""
    shelf.keep(polls(NOON, NOON + 5))
    shelf.database.write_now(lambda c: c.execute("UPDATE journal SET seq = seq + ?", (2**40,)))
    shelf.keep(polls(NOON + 5, NOON + 10))
    shelf.database.write_now(lambda c: c.execute("UPDATE journal SET seq = 1 WHERE seq > ?", (2**40 + 1,)))
    shelf.start_again()
    for _ in range(2):
        found = shelf.query("actual", NOON, NOON + 10).series.average
        assert [value for value in found if value is not None] == [1000 + i % 7 for i in [*range(25)] * 2]
        shelf.fold()


def test_a_snapshot_does_not_hide_the_loss_before_it(shelf: Shelf) -> None:
    """A worker that was quicker than the server: its state first, then what it kept."""
    shelf.keep(polls(NOON, NOON + 5, lambda _: 1000))
    shelf.start_again()
    shelf.keep([UnitLink(1, NOON + 9, "online")])
    shelf.keep([UnitLink(1, NOON + 6, "online"), *polls(NOON + 6, NOON + 8, lambda _: 1000)])
    shelf.keep([UnitLink(1, NOON + 8.5, "stale"), UnitLink(1, NOON + 9, "online")])
    shelf.keep(polls(NOON + 9, NOON + 12, lambda _: 1000))
    assert shelf.query("actual", NOON, NOON + 12).series.average.count(None) == 2


def test_a_duplicate_delivery_hides_no_gap(shelf: Shelf) -> None:
    first = polls(NOON, NOON + 5, lambda _: 1000)
    shelf.keep(first)
    shelf.keep([UnitLink(1, NOON + 5.5, "stale"), UnitLink(1, NOON + 8, "online")])
    shelf.keep([*first[10:], *polls(NOON + 8, NOON + 10, lambda _: 1000)])
    for value in ("actual", "run"):
        assert shelf.query(value, NOON, NOON + 10).series.average.count(None) == 1


def test_late_minutes_are_worked_out_again(shelf: Shelf, tmp_path: Path) -> None:
    punctual = _another_shelf(tmp_path)
    all_readings = polls(NOON, NOON + 600, lambda i: i * 7 % 2000)
    punctual.keep(all_readings)
    punctual.fold()
    for part in (all_readings[:500] + all_readings[1500:], all_readings[500:1500]):
        shelf.keep(part)
        shelf.fold()
    for value in ("actual", "commanded", "analog", "run"):
        for most in (20_000, 50, 7):
            late, early = (each.query(value, NOON, NOON + 600, most) for each in (shelf, punctual))
            assert late == early
    shelf.pack()
    punctual.pack()
    assert rows_of(shelf) == rows_of(punctual)
    punctual.close()


def _another_shelf(folder: Path) -> Shelf:
    (folder / "other").mkdir()
    return Shelf(folder / "other" / "history.db")


def rows_of(shelf: Shelf) -> list[tuple[object, ...]]:
    def read(connection: sqlite3.Connection) -> list[tuple[object, ...]]:
        tables = {
            "raw": "start, span, points, data",
            "minutes": "start, data",
            "hours": "start, data",
            "bits": "*",
        }
        return [
            tuple(row)
            for table, columns in tables.items()
            for row in connection.execute(f"SELECT {columns} FROM {table} ORDER BY 1, 2")
        ]

    return shelf.database.read_now(read)


def test_an_hour_that_is_over_is_packed_and_still_takes_late_readings(shelf: Shelf, tmp_path: Path) -> None:
    shelf.keep(polls(NOON, NOON + 180))
    shelf.keep(polls(NOON + 240, NOON + 300))
    shelf.fold()
    before = shelf.query("actual", NOON, NOON + 300)
    shelf.pack()
    spans = shelf.database.read_now(lambda c: c.execute("SELECT span FROM raw").fetchall())
    assert [row[0] for row in spans] == [HOUR]
    assert shelf.query("actual", NOON, NOON + 300) == before
    shelf.keep(polls(NOON + 180, NOON + 240))
    shelf.fold()
    assert shelf.query("actual", NOON, NOON + 300).series.average.count(None) == 0
    punctual = _another_shelf(tmp_path)
    punctual.keep(polls(NOON, NOON + 180) + polls(NOON + 240, NOON + 300) + polls(NOON + 180, NOON + 240))
    punctual.fold()
    punctual.pack()
    assert rows_of(shelf) == rows_of(punctual)
    punctual.close()


@pytest.mark.parametrize("stored_before", [0, 40])
def test_rollups_are_the_same_before_and_after_their_hour_is_packed(shelf: Shelf, stored_before: int) -> None:
    """``stored_before``: minutes of which another version has stored the rollups already."""
    shelf.keep(polls(NOON + 1800, NOON + 1800 + 60 * stored_before))
    shelf.fold()
    shelf.database.write_now(_roll_up_unpacked)
    shelf.keep([reading(NOON + 1830 + i * 4.0, i * 11 % 1500, inputs=i // 9 % 4) for i in range(1800)])
    shelf.fold()
    wanted = [(value, tier) for value in ("actual", "run", "analog") for tier in ("minutes", "hours")]

    def rollups() -> list[Points]:
        return [shelf.database.read_now(partial(_rollups, value, tier)) for value, tier in wanted]

    before = rollups()
    assert min(len(each.at) for each in before) >= 2
    assert before[0].weight[2] >= 15
    shelf.pack()
    assert rollups() == before


def _roll_up_unpacked(connection: sqlite3.Connection) -> None:
    blocks = [tuple(row) for row in connection.execute("SELECT unit, start, span, points, data, id FROM raw")]
    for unit, start, *_ in blocks[:1]:
        compact(connection, unit, start - start % HOUR)
        compact(connection, unit, start - start % HOUR + HOUR)
    connection.execute("DELETE FROM raw")
    connection.executemany(tables.INSERT_RAW, blocks)


def _rollups(value: str, tier: tables.RollupTier, connection: sqlite3.Connection) -> Points:
    source = StoredUnit(connection, tables.units_of(connection, BUS.name)[0], ())
    return query.rollups(source, tier, VALUES[value], micros(NOON), micros(NOON + 10_000))


def test_what_was_on_disk_survives_a_crash(shelf: Shelf, tmp_path: Path) -> None:
    shelf.keep([parameter(3, 0), *polls(NOON, NOON + 30)])
    shelf.keep(polls(NOON + 30, NOON + 90))
    before = shelf.query("actual", NOON, NOON + 90)
    again = Shelf(tmp_path / "history.db")
    assert again.query("actual", NOON, NOON + 90) == before
    again.fold()
    assert again.query("actual", NOON, NOON + 90) == before
    journal = again.database.read_now(lambda c: c.execute("SELECT count(*) FROM journal").fetchone()[0])
    assert journal == 0
    again.close()


def test_a_crash_between_folding_and_forgetting_counts_nothing_twice(shelf: Shelf) -> None:
    readings = polls(NOON, NOON + 120)
    shelf.keep(readings)
    shelf.fold()
    once = shelf.query("actual", NOON, NOON + 120, 2), rows_of(shelf)
    shelf.keep(readings)
    shelf.fold()
    assert (shelf.query("actual", NOON, NOON + 120, 2), rows_of(shelf)) == once


def test_a_clock_set_back_an_hour_loses_nothing(shelf: Shelf) -> None:
    first = polls(NOON, NOON + 120, lambda i: 1000 + i)
    again = polls(NOON + 0.05, NOON + 120.05, lambda i: 5000 + i)
    shelf.keep(first)
    shelf.keep(again)
    shelf.fold()
    found = shelf.query("actual", NOON, NOON + 121)
    assert sorted(v for v in found.series.average if v is not None) == sorted(
        float(r.actual) for r in first + again if hasattr(r, "actual")
    )
    assert found.series.at == sorted(found.series.at)


@pytest.mark.parametrize("step", [YEAR, -YEAR])
def test_a_clock_that_jumps_by_a_year_and_back_loses_nothing(shelf: Shelf, step: float) -> None:
    for start in (NOON, NOON + step, NOON + 60):
        shelf.keep(polls(start, start + 60))
    shelf.fold()
    shelf.pack()
    for start in (NOON, NOON + step, NOON + 60):
        assert len(shelf.query("actual", start, start + 60).series.at) == 300


def test_readings_are_stored_after_a_clock_was_ahead_for_long(
    shelf: Shelf, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was given up was before a time of the next year, and new readings were given up, too."""
    running = [0.0]
    monkeypatch.setattr("app.line.history.writer.monotonic_now", lambda: running[0])
    upkeep = Upkeep(shelf.database, HistorySettings(), DiskReserve(), lambda _: None)
    shelf.keep(polls(NOON, NOON + 60))
    shelf.fold()
    ahead = micros(NOON + YEAR)
    upkeep.clock_stepped(ahead)
    upkeep.give_up_old(ahead)
    assert shelf.database.read_now(tables.raw_from) == 0, "an hour passes before anything is given up"
    running[0] += SETTLED_S
    upkeep.give_up_old(ahead)
    assert shelf.database.read_now(tables.raw_from) > micros(NOON)
    upkeep.clock_stepped(micros(NOON + 60))
    shelf.keep(polls(NOON + 60, NOON + 120))
    shelf.fold()
    assert len(shelf.query("actual", NOON + 60, NOON + 120).series.at) == 300


def test_a_long_span_is_read_from_minutes_and_hours(shelf: Shelf) -> None:
    readings = [reading(NOON + i * 20.0, 1000 + i % 3) for i in range(3 * 1440)]
    shelf.keep([parameter(3, 0), *readings])
    shelf.fold()
    shelf.pack()
    day = shelf.query("actual", NOON, NOON + 86_400, 100)
    assert (day.resolution, len(day.series.at) <= 100) == ("minutes", True)
    assert (set(day.series.least), set(day.series.greatest)) == ({1000.0}, {1002.0})
    assert set(day.series.average) == {1001.0}
    assert shelf.query("actual", NOON, NOON + 86_400, 20).resolution == "hours"
    assert shelf.query("remote", NOON, NOON + 86_400, 20).series.average == [1.0, 1.0]


def test_bits_are_kept_exactly_when_the_readings_are_given_up(shelf: Shelf) -> None:
    readings = [reading(NOON + i / 5, inputs=0b10 | (i // 100 % 2)) for i in range(1000)]
    shelf.keep(readings)
    shelf.fold()
    exact = shelf.query("run", NOON, NOON + 200)
    assert len(exact.series.at) == 2 * 10
    drop = partial(tables.drop_raw, before=micros(NOON + 86_400), most=1000)
    assert shelf.database.write_now(drop) == 0, "what has no rollups yet"
    shelf.pack()
    shelf.database.write_now(lambda c: tables.write_raw_from(c, micros(NOON + 86_400)))
    assert shelf.database.write_now(drop) == 1
    assert shelf.query("run", NOON, NOON + 200) == exact
    assert shelf.query("actual", NOON, NOON + 200).resolution == "minutes"


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


def test_a_store_of_a_newer_version_is_refused_in_words(tmp_path: Path) -> None:
    opened(tmp_path).close()
    with sqlite3.connect(tmp_path / "history.db") as connection:
        connection.execute("INSERT INTO migrations VALUES (9999, 'later', 0)")
    writer = opened(tmp_path)
    assert "newer version" in str(writer.status.message)
    writer.close()


RESERVE = DiskReserve(announce=1000, trim=500, pause=100)


@pytest.mark.parametrize(("free", "meaning"), [(1000, "ok"), (999, "low"), (499, "scarce"), (99, "paused")])
def test_less_free_space_means_a_stricter_state(free: int, meaning: StoreState) -> None:
    assert space(free, RESERVE) == meaning
