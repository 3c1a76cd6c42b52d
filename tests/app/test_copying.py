"""A copy of tables that change, ended anywhere: nothing is missing and nothing is doubled."""

from __future__ import annotations

import random
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from app.database import SqliteDatabase
from app.database.copying import rows, walk
from app.database.copying.places import Folder, PostgresqlPlace, StorePart
from app.database.copying.rows import Chunk, Tally, chunk_of, common_end, packed, packed_key, unpacked_key
from app.database.copying.sides import CopyTarget
from app.database.copying.site import RUNNING, SiteCopy, state_of
from app.database.copying.tables import StoreTable, tables_of
from app.database.engine import tables_in
from app.database.unfinished import LEDGER
from app.errors import StoreError
from tests.postgresql import fresh_database, needs_postgresql
from tests.sizes import sizes

STEP = """
CREATE TABLE events (id INTEGER PRIMARY KEY, about INTEGER REFERENCES events (id), hash TEXT NOT NULL) STRICT;
CREATE TRIGGER events_stay BEFORE DELETE ON events
BEGIN SELECT RAISE(ABORT, 'an event is never removed'); END;
CREATE TABLE events_archive (last INTEGER PRIMARY KEY, first_hash TEXT NOT NULL) STRICT;
CREATE TABLE parent (name TEXT PRIMARY KEY, role INTEGER) STRICT, WITHOUT ROWID;
CREATE TABLE child (
    parent TEXT NOT NULL REFERENCES parent (name) ON DELETE CASCADE,
    at REAL NOT NULL,
    data BLOB,
    PRIMARY KEY (parent, at)
) STRICT, WITHOUT ROWID;
CREATE TABLE block (id INTEGER PRIMARY KEY, start INTEGER NOT NULL, only TEXT, UNIQUE (start)) STRICT;
"""


class Ended(Exception):
    """The command was killed."""


@dataclass
class ChangingSite:
    """Tables in a folder, changed at random."""

    folder: Path
    chance: random.Random

    @property
    def part(self) -> StorePart:
        return StorePart("main", "m.db", self.folder / "steps")

    def change(self, count: int) -> None:
        with closing(sqlite3.connect(self.folder / "m.db")) as store, store:
            store.execute("PRAGMA foreign_keys = ON")
            for _ in range(count):
                self._change(store)

    def _change(self, store: sqlite3.Connection) -> None:
        number, name = self.chance.randrange(30), f"{chr(self.chance.choice((65, 97, 228, 128_512)))}"
        last = store.execute("SELECT max(id) FROM events").fetchone()[0] or 0
        changes: list[tuple[str, tuple[Any, ...]]] = [
            (
                "INSERT INTO events VALUES (?, ?, 'h')",
                (last + 1, self.chance.randint(1, last) if last else None),
            ),
            ("INSERT OR REPLACE INTO block (start, only) VALUES (?, ?)", (number, name)),
            ("DELETE FROM block WHERE id >= (SELECT max(id) FROM block) - ?", (number // 6,)),
            ("DELETE FROM block WHERE id % 7 = ?", (number % 7,)),
            ("UPDATE block SET only = ? WHERE start = ?", (name, number)),
            ("UPDATE OR IGNORE block SET start = -1 - start WHERE id % 3 = ?", (number % 3,)),
            (
                "UPDATE OR IGNORE block SET start = -start WHERE start < 0 AND NOT EXISTS"
                " (SELECT 1 FROM block other WHERE other.start = -block.start)",
                (),
            ),
            ("INSERT OR IGNORE INTO parent VALUES (?, ?)", (name * (1 + number % 3), number)),
            ("UPDATE parent SET role = ?", (number,)),
            ("DELETE FROM parent WHERE role % 5 = ?", (number % 5,)),
            (
                "INSERT OR REPLACE INTO child SELECT name, ?, ? FROM parent",
                (number / 4, bytes([number]) * number),
            ),
            ("DELETE FROM child WHERE at > ?", (number / 4,)),
        ]
        store.execute(*self.chance.choice(changes))


@pytest.fixture
def steps(tmp_path: Path) -> Path:
    folder = tmp_path / "steps"
    folder.mkdir()
    (folder / "0001_all.sql").write_text(STEP)
    return folder


@contextmanager
def ending_at(target_class: type[CopyTarget], left: int, *, before: bool) -> Iterator[None]:
    """Kill the command at a transaction of the target: ``before`` it or after it is on disk."""
    transaction = target_class.transaction

    def counted(target: CopyTarget, work: Callable[[Any], Any]) -> Any:
        nonlocal left
        left -= 1
        if left == 0 and before:
            raise Ended
        result = transaction(target, work)
        if left == 0:
            raise Ended
        return result

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(target_class, "transaction", counted)
        yield


def pass_over(copy: SiteCopy, chance: random.Random, target_class: type[CopyTarget]) -> bool:
    """One call of the command; whether it came to its end, with both sides equal where that is known."""
    try:
        with ending_at(target_class, chance.randint(1, 60), before=chance.random() < 0.5):
            last = {step.progress.table: step.progress for step in copy.follow()}
            if copy.mark != RUNNING:
                assert all(progress.holds for progress in last.values()), last
                copy.finish()
    except Ended:
        # It may have been the last one.
        with copy.target.reading(copy.parts[0]) as side:
            return LEDGER not in tables_in(side.connection)
    return True


def everything(place: Folder | PostgresqlPlace, part: StorePart) -> dict[str, Any]:
    with place.reading(part) as side:
        return {table.name: side.chunk(table, None, 10_000).forms for table in tables_of(part.steps)}


def copied_at_random(
    folder: Path, target: Folder | PostgresqlPlace, target_class: type[CopyTarget], seed: int
) -> None:
    chance = random.Random(seed)
    site = ChangingSite(folder, chance)
    source, part = Folder(folder), site.part
    with closing(SqliteDatabase(folder / "m.db", part.steps)):
        pass
    site.change(60)
    for _ in range(chance.randint(0, 6)):
        pass_over(SiteCopy(source, target, [part], RUNNING), chance, target_class)
        site.change(chance.randint(0, 30))
    while not pass_over(SiteCopy(source, target, [part], state_of(source, part)), chance, target_class):
        if chance.random() < 0.3:
            # A server ran in between, which every start notes.
            site.change(chance.randint(0, 10))
            with closing(sqlite3.connect(folder / "m.db")) as store, store:
                store.execute("INSERT INTO events (hash) VALUES ('start')")
    assert everything(target, part) == everything(source, part)


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "MAX_ROWS", 3)
    monkeypatch.setattr(walk, "FIRST_ROWS", 1)


@pytest.mark.parametrize("first", sizes(0, *range(10, 300, 10)))
def test_files_that_are_ended_anywhere(steps: Path, first: int) -> None:
    from app.database.copying.files import FileTarget

    for seed in range(first, first + 10):
        folder = steps.parent / f"{seed}"
        folder.mkdir()
        (folder / "steps").symlink_to(steps)
        copied_at_random(folder, Folder(folder / "copy"), FileTarget, seed)


@needs_postgresql
@pytest.mark.parametrize("seed", sizes(300, *range(301, 330)))
def test_a_database_that_is_ended_anywhere(steps: Path, seed: int) -> None:
    from app.database.postgresql.copying import DatabaseTarget

    with fresh_database(empty=True) as store:
        copied_at_random(steps.parent, PostgresqlPlace(store), DatabaseTarget, seed)


def test_an_event_that_only_the_copy_has_is_not_removed(steps: Path, tmp_path: Path) -> None:
    site = ChangingSite(tmp_path, random.Random(1))
    source, target = Folder(tmp_path), Folder(tmp_path / "copy")
    with closing(SqliteDatabase(tmp_path / "m.db", steps)):
        pass
    site.change(100)
    list(SiteCopy(source, target, [site.part], RUNNING).follow())
    with closing(sqlite3.connect(tmp_path / "copy" / "m.db")) as store, store:
        store.execute("INSERT INTO events VALUES (9000, NULL, 'forged')")
    with pytest.raises(StoreError, match="never removed"):
        list(SiteCopy(source, target, [site.part], "stopped").follow())


def test_values_that_differ_have_forms_that_differ() -> None:
    values = [0, 0.0, -0.0, 1, 1.0, "", b"", None, "0", b"0", 2**63 - 1, -(2**63), 1e300, "ä", "ä".encode()]
    assert len({packed((value,)) for value in values}) == len(values)
    assert all(repr(unpacked_key(packed_key((value, 1)))) == repr((value, 1)) for value in values)
    assert unpacked_key(packed_key(None)) is None


def test_a_digest_depends_on_the_order_and_not_on_the_chunks() -> None:
    forms = [packed((number, "x" * number)) for number in range(9)]
    one = Tally().with_rows(forms)
    assert Tally().with_rows(forms[:4]).with_rows([]).with_rows(forms[4:]) == one
    assert Tally().with_rows(forms[::-1]).digest != one.digest
    assert one.rows == 9


def test_chunks_are_compared_as_far_as_both_reach() -> None:
    table = StoreTable("t", {"id": "INTEGER"}, ("id",), (), is_referenced=False)

    def chunk(*numbers: int) -> Chunk:
        return chunk_of(table, [(number,) for number in numbers])

    assert common_end((chunk(1, 2), 2), (chunk(5, 6), 2)) == (2,)
    assert common_end((chunk(1, 9), 2), (chunk(5, 6), 2)) == (6,)
    assert common_end((chunk(1), 2), (chunk(5, 6), 2)) == (6,)
    assert common_end((chunk(1), 2), (chunk(), 2)) is None
    assert [*chunk(1, 5, 9).until((6,)).rows] == [(1,), (5,)]
