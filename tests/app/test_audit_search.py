"""The index over the events finds what is found without it."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.audit import search, store
from app.audit.keys import passing_keys
from app.audit.log import EventLog
from app.audit.store import Filter
from app.database import Database, connection
from app.errors import TooCostlyError
from app.web.access import Role
from tests.app.complete_app import complete_app

WORDS = ["speed", "Speed set", "unit 3", "ramp_up 50%", "Ärger", "a!b", 'say "so"', "", "x", "ab", "no\0text"]
words = st.sampled_from(WORDS)
PATIENCE_S = 10.0


@contextmanager
def database(folder: Path) -> Iterator[Database]:
    with closing(Database(folder / "lineside.db", synchronous="NORMAL")) as opened:
        yield opened


def add(database: Database, count: int, entry: Callable[[int], dict[str, Any]]) -> None:
    """Add ``count`` entries; each second one is the result of the one before."""
    nothing: dict[str, Any] = dict.fromkeys(store.FIELDS)
    keys = passing_keys()
    blank = {"who": "", "origin": "", "what": "", "message": "", "frames": "[]", "kind": "command"}

    def write(into: sqlite3.Connection) -> None:
        for number in range(count):
            store.append(into, {**nothing, **blank, "time": float(number), **entry(number)}, keys)

    database.write_now(write)


def texts(seed: int) -> Callable[[int], dict[str, Any]]:
    def entry(number: int) -> dict[str, Any]:
        word = [WORDS[(seed + number * step) % len(WORDS)] for step in (1, 3, 5, 7)]
        about = number if number % 3 == 2 else None
        searched = {
            "what": word[0],
            "who": word[1],
            "old": word[2],
            "message": word[3],
            "unit": number % 2 + 1,
        }
        return {"about": about, "message": word[3]} if about else searched

    return entry


def found(database: Database, wanted: Filter, limit: int) -> list[int]:
    return [event["id"] for event in database.read_now(lambda c: store.select(c, wanted, limit))]


@pytest.mark.parametrize("pieces", [0, 1, 100])
def test_with_and_without_the_index_the_same_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pieces: int
) -> None:
    monkeypatch.setattr(store, "SCANNED_ROWS", 10)
    monkeypatch.setattr(search, "MAX_AT_ONCE", 20)
    with database(tmp_path) as plain:
        add(plain, 100, texts(4))

        @given(words, st.integers(1, 120), st.none() | st.integers(1, 120), st.none() | st.integers(1, 2))
        def compare(text: str, limit: int, before: int | None, unit: int | None) -> None:
            wanted = Filter(search=text, before=before, unit=unit)
            plainly = plain.read_now(lambda c: store._select(c, wanted, limit))
            assert found(plain, wanted, limit) == [event["id"] for event in plainly]

        compare()
        plain.write_now(search.prepare)
        add(plain, 50, lambda number: texts(9)(number) | {"about": None})
        for _ in range(pieces):
            plain.write_now(search.index_more)
        assert plain.read_now(search.lowest_indexed) == max(101 - 20 * pieces, 1)
        compare()


def test_the_index_is_used(tmp_path: Path) -> None:
    with database(tmp_path) as opened:
        opened.write_now(search.prepare)
        query = f"EXPLAIN QUERY PLAN {store._FOLDED} AND e.id IN ({search.MATCHING}) ORDER BY e.id DESC"
        plan = opened.read_now(lambda c: [row["detail"] for row in c.execute(query, ('"abc"',))])
        assert any("events_text VIRTUAL TABLE" in step for step in plan)
        assert "SEARCH e USING INTEGER PRIMARY KEY (rowid=?)" in plan


def test_without_fts5_events_are_written_and_searched_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with database(tmp_path) as opened:
        opened.write_now(search.prepare)
        monkeypatch.setattr(search, "is_possible", lambda _: False)
        opened.write_now(search.prepare)
        opened.write_now(lambda c: c.execute("DROP TABLE events_text"))
        add(opened, 20, texts(1))
        assert opened.read_now(search.lowest_indexed) is None
        assert not opened.write_now(search.index_more)
        missed = found(opened, Filter(search="speed"), 100)
        assert missed
        monkeypatch.undo()
        opened.write_now(search.prepare)
        while opened.write_now(search.index_more):
            pass
        assert found(opened, Filter(search="speed"), 100) == missed


async def test_the_log_is_indexed_from_the_start_of_the_server(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        events, rows = house.services[EventLog], house.services[Database].read_now
        await events.index()
        assert rows(search.lowest_indexed) == 1
        number = await events.record(kind="server", what="a needle")
        [found], after = await events.page(Filter(search="NEEDLE"), 10)
        assert (found["id"], after) == (number, None)
        client = await house.signed_in(Role.VIEWER)
        assert "a needle" in (await client.get("/events?search=needl")).text
        assert "server" in await events.kinds()


async def test_a_search_beyond_its_budget_ends_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "COSTLY_S", -1.0)
    monkeypatch.setattr(connection, "STEPS", 10)
    async with complete_app(tmp_path) as house:
        for _ in range(20):
            await house.services[EventLog].record(kind="server", what="hay")
        client = await house.program(Role.VIEWER)
        response = await client.get("/api/v1/events?search=needle")
        assert (response.status_code, response.json()["code"]) == (503, "too_costly")
        page = await house.signed_in(Role.OPERATOR)
        german = await page.get("/events?search=x", headers={"accept-language": "de"})
        assert "dauert zu lange" in german.text
        monkeypatch.undo()
        assert (await client.get("/api/v1/events?search=hay")).status_code == 200


async def test_costly_reads_leave_the_others_alone(tmp_path: Path) -> None:
    with database(tmp_path) as opened:
        log, gate = EventLog(opened), threading.Event()
        held = [asyncio.create_task(opened.read_costly(lambda _: gate.wait())) for _ in range(50)]
        try:
            async with asyncio.timeout(PATIENCE_S):
                await log.record(kind="server", what="written meanwhile")
                assert await opened.read(store.open_intents) == []
        finally:
            gate.set()
            await asyncio.gather(*held)


def test_a_costly_read_is_ended_between_two_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "COSTLY_S", 0.0)
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT max(i) FROM n"
    with database(tmp_path) as opened:
        with pytest.raises(TooCostlyError, match="takes too long"):
            opened._read_within(lambda c: c.execute(endless).fetchone())
        assert opened.read_now(lambda c: c.execute("SELECT 1").fetchone()[0]) == 1
