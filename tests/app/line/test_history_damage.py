"""Damage on the disk: it is detected while running, costs only what it hit, and is reported."""

from __future__ import annotations

import asyncio
import os
import random
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from app.core.web.formats import Formats
from app.errors import DamagedStoreError
from app.line.history import writer as writing
from app.line.history.query import SeriesQuery, run_query
from app.line.history.recorder import Recorder, compact
from app.line.history.series.runs import DAY, HOUR, MINUTE, micros
from app.line.history.series.values import VALUES
from app.line.history.service import FILE, History
from app.line.history.settings import HistorySettings
from app.line.history.status import DiskReserve, store_notice
from app.line.history.tables import BlockKey, StoredTier
from app.line.history.writer import Upkeep, Writer
from bus.instants import unix_now
from bus.messages import Message
from tests.app.fake_worker import until as arrived
from tests.app.history_line import BUS, NOON, Shelf, opened, polls, until
from tests.sizes import sizes

START = micros(NOON)
NOISE = [chance.randrange(99_999) for chance in [random.Random(3)] for _ in range(9_000)]
"""What cannot be packed small: many pages."""


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf]:
    shelf = Shelf(tmp_path / FILE)
    yield shelf
    shelf.close()


def spoil(path: Path, table: str, start: int) -> None:
    """One byte of a block, as a failing disk leaves it."""
    with closing(sqlite3.connect(path, timeout=30)) as connection, connection:
        (blob,) = connection.execute(f"SELECT data FROM {table} WHERE start = ?", (start,)).fetchone()
        spoiled = blob[:-3] + bytes([blob[-3] ^ 0xFF]) + blob[-2:]
        assert (
            connection.execute(f"UPDATE {table} SET data = ? WHERE start = ?", (spoiled, start)).rowcount == 1
        )


def test_a_damaged_block_costs_itself_and_the_rest_is_read(shelf: Shelf) -> None:
    shelf.keep(polls(NOON, NOON + 180))
    shelf.fold()
    spoil(shelf.database.path, "raw", START + MINUTE)
    found = shelf.query("actual", NOON, NOON + 180)
    assert [block.start for block in found.damaged] == [START + MINUTE]
    assert found.series.average.count(None) == 1
    kept = [t for t, v in zip(found.series.at, found.series.average, strict=True) if v is not None]
    assert len(kept) == 600
    assert not [t for t in kept if START + MINUTE <= t < START + 2 * MINUTE]


@pytest.mark.parametrize("late", [False, True], ids=["the next minute", "the damaged minute itself"])
@pytest.mark.parametrize("table", ["raw", "minutes", "hours"])
def test_folding_goes_on_past_it(shelf: Shelf, table: str, late: bool) -> None:
    shelf.keep(polls(NOON, NOON + 60))
    shelf.fold()
    if table != "raw":
        shelf.pack()
    place = {"raw": START, "minutes": START, "hours": START - START % DAY}[table]
    spoil(shelf.database.path, table, place)
    shelf.keep(polls(NOON + 30.1, NOON + 90) if late else polls(NOON + 60, NOON + 90))
    shelf.fold()
    assert shelf.tail.everything() == []
    found = shelf.query("actual", NOON + 60, NOON + 90)
    assert len(found.series.at) == 150
    assert not found.damaged


@pytest.mark.parametrize("table", ["raw", "minutes", "hours"])
def test_a_damaged_block_is_set_aside_and_reported_once(tmp_path: Path, table: StoredTier) -> None:
    words: list[str] = []
    writer = opened(tmp_path)
    writer.enqueue((BUS.name, polls(NOON, NOON + 150)))
    writer.close()
    if table != "raw":
        shelf = Shelf(tmp_path / FILE)
        shelf.pack()
        shelf.close()
    place = START - START % DAY if table == "hours" else START
    spoil(tmp_path / FILE, table, place)
    damaged = BlockKey(table, unit_key(tmp_path), place)
    writer = opened(tmp_path, on_damage=lambda what: words.append(str(what)))
    writer.report([damaged, damaged, BlockKey("raw", damaged.unit, START + MINUTE)])
    writer.enqueue((BUS.name, polls(NOON + 200, NOON + 210)))
    until(lambda: writer.status.waiting == 0 and not writer._reported)
    writer.close()
    assert ["it is missing" in text for text in words] == [True]
    with closing(sqlite3.connect(tmp_path / FILE)) as connection:
        assert connection.execute("SELECT tier, start FROM damaged").fetchall() == [(table, place)]


def unit_key(folder: Path) -> int:
    with closing(sqlite3.connect(folder / FILE)) as connection:
        return int(connection.execute("SELECT id FROM unit WHERE number = 1").fetchone()[0])


def test_an_hour_with_a_damaged_minute_is_packed_without_it(shelf: Shelf) -> None:
    shelf.keep(polls(NOON, NOON + 180))
    shelf.fold()
    key = unit_key(shelf.database.path.parent)
    spoil(shelf.database.path, "raw", START + MINUTE)
    with pytest.raises(ValueError, match="damaged"):
        shelf.database.write_now(lambda c: compact(c, key, START))
    upkeep = Upkeep(shelf.database, HistorySettings(), DiskReserve(), lambda _: None)
    upkeep.compact(START + 2 * HOUR, float("inf"))
    found = shelf.query("actual", NOON, NOON + 180)
    assert (len(found.series.at), found.damaged) == (601, [])


async def test_a_damaged_block_that_is_read_is_a_gap_and_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "LOOK_EVERY_S", 0.0)
    words: list[str] = []
    history = History(tmp_path, [BUS])
    history.start()
    history.append(BUS.name, polls(NOON, NOON + 180))
    history.close()
    spoil(tmp_path / FILE, "raw", START)
    history = History(tmp_path, [BUS])
    history.on_fault(lambda _kind, what, _at: words.append(str(what)))
    history.start()
    query = SeriesQuery(BUS, 1, VALUES["actual"], micros(NOON), micros(NOON + 180), 1000)
    try:
        for _ in range(2):
            assert len((await history.query([query]))[0].series.at) == 600
            until(lambda: history.status.damaged == 1)
        assert "stored values were damaged" in str(history.status.message)
    finally:
        history.close()
    await asyncio.sleep(0)
    assert len(words) == 1
    assert "it is missing: every value of dry-end/1 from 2026-11-21T12:00+00:00" in words[0]


@pytest.mark.parametrize("seed", sizes(0, *range(1, 12)))
async def test_pages_overwritten_while_it_runs_cost_what_lay_on_them(tmp_path: Path, seed: int) -> None:
    """Half of the store is overwritten at once; recording continues, in a new store where it has to."""
    writer = opened(tmp_path)
    writer.enqueue((BUS.name, polls(NOON, NOON + 900, NOISE.__getitem__)))
    writer.close()
    history = History(tmp_path, [BUS])
    history.start()
    try:
        overwrite_pages(tmp_path / FILE, random.Random(seed))
        history.append(BUS.name, polls(NOON, NOON + 900))
        history.append(BUS.name, polls(NOON + 1200, NOON + 1260))
        await arrived(
            lambda: history.status.waiting == 0 and not history._writer.tail.everything(), "folding"
        )
        await arrived(lambda: history.status.state == "ok", "a store that can be written")
        history.append(BUS.name, polls(NOON + 1300, NOON + 1360))
        await arrived(lambda: history.status.waiting == 0, "recording")
        query = SeriesQuery(BUS, 1, VALUES["actual"], micros(NOON + 1300), micros(NOON + 1360), 1000)
        assert len((await history.query([query]))[0].series.at) == 300
    finally:
        history.close()


def overwrite_pages(path: Path, chance: random.Random) -> None:
    """Overwrite every other page except those of the schema."""
    with closing(sqlite3.connect(path)) as connection:
        size = connection.execute("PRAGMA page_size").fetchone()[0]
        roots = {row[0] for row in connection.execute("SELECT rootpage FROM sqlite_master")}
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    pages = path.stat().st_size // size
    with path.open("r+b") as file:
        for page in range(3, pages + 1):
            if page not in roots and chance.random() < 0.5:
                file.seek((page - 1) * size)
                file.write(chance.randbytes(size))


def readings_of(writer: Writer) -> int:
    query = SeriesQuery(BUS, 1, VALUES["actual"], micros(NOON), micros(NOON + 3600), 20_000)
    found = writer.database.read_now(lambda connection: run_query(connection, writer.tail, query))
    return sum(value is not None for value in found.series.average)


def torn(folder: Path) -> int:
    """Store half an hour, and damage it; return the size."""
    writer = opened(folder)
    writer.enqueue((BUS.name, polls(NOON, NOON + 1800, NOISE.__getitem__)))
    writer.close()
    tear(folder / FILE)
    return (folder / FILE).stat().st_size


def test_a_torn_store_is_put_aside_and_history_begins_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "LOOK_EVERY_S", 0.0)
    size = torn(tmp_path)
    words: list[str] = []
    writer = opened(tmp_path, on_damage=lambda what: words.append(str(what)))
    meet_damage(writer)
    until(lambda: bool(words) and writer.status.put_aside != "")
    [aside] = tmp_path.glob(f"{FILE}.damaged-*Z")
    # What was freed before the damage was met, it may have given back.
    assert aside.stat().st_size > size / 2
    assert words == [
        f"the store of the history was damaged and is kept as {aside.name}; a new one begins here"
    ]
    status = writer.status
    assert (status.state, status.put_aside, status.damaged) == ("ok", aside.name, 1)
    formats = Formats("en", "Europe/Berlin")
    shown = str(store_notice(status, formats, unix_now()))
    assert f"History before {formats.since(status.begun, unix_now())} is not shown" in shown
    assert aside.name in shown
    assert aside.name in str(status.message)
    writer.enqueue((BUS.name, polls(NOON + 2400, NOON + 2460)))
    until(lambda: writer.status.waiting == 0)
    assert readings_of(writer) == 300
    writer.close()
    writer = opened(tmp_path)
    until(lambda: writer.status.put_aside == aside.name)
    writer.close()


def test_a_store_that_is_torn_again_within_a_day_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "RETRY_S", 0.1)
    torn(tmp_path)
    writer = opened(tmp_path)
    meet_damage(writer)
    until(lambda: bool(list(tmp_path.glob(f"{FILE}.damaged-*Z"))) and writer.status.state == "ok")
    with monkeypatch.context() as damaged:
        damaged.setattr(Recorder, "commit", fail_damaged)
        writer.enqueue((BUS.name, polls(NOON + 2400, NOON + 2460)))
        until(lambda: writer.status.state == "failed")
    until(lambda: writer.status.waiting == 0)
    assert readings_of(writer) == 300
    writer.close()
    assert len(list(tmp_path.glob(f"{FILE}.damaged-*Z"))) == 1


def test_a_store_that_proves_intact_is_not_put_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after an error of the memory, which a second look does not meet."""
    monkeypatch.setattr(writing, "RETRY_S", 0.1)
    writer = opened(tmp_path)
    before = writer._open
    with monkeypatch.context() as damaged:
        damaged.setattr(Recorder, "commit", fail_damaged)
        writer.enqueue((BUS.name, polls(NOON, NOON + 60)))
        until(lambda: writer._open not in (None, before))
    until(lambda: writer.status.waiting == 0)
    assert readings_of(writer) == 300
    writer.close()
    assert not list(tmp_path.glob(f"{FILE}.damaged-*"))


def fail_damaged(*_: object) -> None:
    raise DamagedStoreError(Message("store_is_damaged"))


def meet_damage(writer: Writer) -> None:
    """Store late readings of the minute that lies on the page that :func:`tear` overwrites."""
    writer.enqueue((BUS.name, polls(NOON + 900, NOON + 930)))


@pytest.mark.parametrize("kept", [0.0, 0.3])
def test_a_store_that_was_cut_short_is_begun_again(tmp_path: Path, kept: float) -> None:
    """As after a copy that was broken off: by so much of its length."""
    writer = opened(tmp_path)
    writer.enqueue((BUS.name, polls(NOON, NOON + 1800, NOISE.__getitem__)))
    writer.close()
    size = (tmp_path / FILE).stat().st_size
    os.truncate(tmp_path / FILE, int(kept * size))
    words: list[str] = []
    writer = opened(tmp_path, on_damage=lambda what: words.append(str(what)))
    until(lambda: writer.status.state == "ok")
    writer.enqueue((BUS.name, polls(NOON + 2400, NOON + 2460)))
    until(lambda: writer.status.waiting == 0)
    assert readings_of(writer) >= 300
    writer.close()
    assert not kept or "a new one begins here" in words[0]
    assert len(list(tmp_path.glob(f"{FILE}.damaged-*Z"))) == bool(kept)
    with closing(sqlite3.connect(tmp_path / FILE)) as connection:
        assert connection.execute("PRAGMA auto_vacuum").fetchone() == (2,), (
            "deleted readings free their space"
        )


def tear(path: Path) -> None:
    """One page in the middle of the table of readings."""
    with closing(sqlite3.connect(path)) as connection:
        size = connection.execute("PRAGMA page_size").fetchone()[0]
        blob = connection.execute("SELECT data FROM raw ORDER BY start LIMIT 1 OFFSET 15").fetchone()[0]
    content = path.read_bytes()
    page = content.index(blob[20:60]) // size
    with path.open("r+b") as file:
        file.seek(page * size)
        file.write(b"\xa5" * size)
