"""What a search of the events finds, and what it may cost."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import product
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.database import database as database_module
from app.core.web.access import Role
from app.errors import TooCostlyError
from app.people.audit.log import EventLog, Filter, open_intents
from tests.app.complete_app import complete_app

PATIENCE_S = 60.0


@contextmanager
def database(folder: Path) -> Iterator[Database]:
    with closing(Database(folder / "lineside.db")) as opened:
        yield opened


PLACES = ("what", "who", "old", "new", "message")
SPECIAL = ["ramp_up 50%", "a!b", 'say "so"', "no\0text", "7"]


async def test_a_text_is_found_in_each_field(tmp_path: Path) -> None:
    with database(tmp_path) as opened:
        events = EventLog(opened)
        await events.record(kind="server", what="hay", who="rampXup 50 a?b")
        for place, text in product(PLACES, SPECIAL):
            number = await events.record(kind="server", **{"what": "hay", place: f"{place} has {text} in it"})
            [found], after = await events.page(Filter(search=f"{place} has {text}".upper()), 10)
            assert (found["id"], after) == (number, None), (place, text)


async def test_the_page_finds_what_a_person_typed(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        await house.services[EventLog].record(kind="server", what="a needle")
        client = await house.signed_in(Role.VIEWER)
        assert "a needle" in (await client.get("/events?search=needl")).text
        assert "server" in await house.services[EventLog].kinds()


def test_a_store_with_the_index_of_earlier_versions_loses_it(tmp_path: Path) -> None:
    with database(tmp_path):
        pass
    with closing(sqlite3.connect(tmp_path / "lineside.db")) as old, old:
        old.execute("CREATE VIRTUAL TABLE events_text USING fts5 (what, content = 'events')")
        old.execute("CREATE TABLE events_text_extent (lowest INTEGER)")
        old.execute("CREATE TRIGGER events_text_follows AFTER INSERT ON events BEGIN SELECT 1; END")
        old.execute("DELETE FROM migrations WHERE number = 130")
    with database(tmp_path) as opened:
        query = "SELECT name FROM sqlite_master WHERE name LIKE 'events_text%'"
        assert opened.read_now(lambda c: c.execute(query).fetchall()) == []


async def test_a_search_beyond_its_budget_ends_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database_module, "COSTLY_S", -1.0)
    monkeypatch.setattr(database_module, "STEPS", 10)
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
                assert await opened.read(open_intents) == []
        finally:
            gate.set()
            await asyncio.gather(*held)


def test_a_costly_read_is_ended_between_two_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_module, "COSTLY_S", 0.0)
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT max(i) FROM n"
    with database(tmp_path) as opened:
        with pytest.raises(TooCostlyError, match="takes too long"):
            opened._read_within(lambda c: c.execute(endless).fetchone())
        assert opened.read_now(lambda c: c.execute("SELECT 1").fetchone()[0]) == 1
