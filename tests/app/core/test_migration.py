"""What opening a store needs: its steps, copies that are kept, and whether a server may start on it."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from app.core.database import Database
from app.core.database import migration as copies
from app.core.database.connection import UNREADABLE, examining, messages_of, stored_messages
from app.core.database.migration import (
    MIGRATIONS,
    Presence,
    copy_of,
    migrations_in,
    presence_of,
    put_aside,
    refusal_to_start,
    remove_older_copies,
)
from app.engineering.sets.model import ParameterRow, UnitRows
from app.engineering.sets.restore_plan import LeftOut, RestorePlan, RowResult, Write
from app.engineering.sets.restore_service import RestoreStore
from app.errors import StoreError
from app.line.commands import record
from bus.messages import Message
from tests.app.complete_app import complete_app
from tests.for_each import for_each

FIRST = "CREATE TABLE a (x INTEGER);\nINSERT INTO a VALUES (1);\n"
SECOND = "ALTER TABLE a ADD COLUMN y INTEGER NOT NULL DEFAULT 7;\n"


def steps(folder: Path, **sql: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in sql.items():
        (folder / f"{name.removeprefix('s')}.sql").write_text(text)
    return folder


def open_and_close(path: Path, folder: Path) -> list[int]:
    database = Database(path, folder)
    database.close()
    return [step.number for step in database.migrated]


def rows(path: Path) -> list[tuple[int, ...]]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT * FROM a").fetchall()


def test_steps_are_taken_once_and_in_order(tmp_path: Path) -> None:
    folder, path = steps(tmp_path / "steps", s0002_second=SECOND, s0001_first=FIRST), tmp_path / "x.db"
    assert open_and_close(path, folder) == [1, 2]
    assert open_and_close(path, folder) == []
    assert rows(path) == [(1, 7)]


def test_a_store_in_use_is_copied_before_it_is_changed(tmp_path: Path) -> None:
    folder, path = steps(tmp_path / "steps", s0001_first=FIRST), tmp_path / "x.db"
    open_and_close(path, folder)
    assert not list(tmp_path.glob("x.db.before-*"))
    steps(folder, s0002_second=SECOND)
    open_and_close(path, folder)
    assert rows(tmp_path / "x.db.before-0002") == [(1,)]
    assert rows(path) == [(1, 7)]


def test_a_step_that_fails_leaves_the_store_as_it_was(tmp_path: Path) -> None:
    folder, path = steps(tmp_path / "steps", s0001_first=FIRST), tmp_path / "x.db"
    open_and_close(path, folder)
    steps(folder, s0002_bad="INSERT INTO a VALUES (2); INSERT INTO nowhere VALUES (1);\n")
    with pytest.raises(StoreError, match="step 0002 bad failed: no such table: nowhere"):
        Database(path, folder)
    assert rows(path) == [(1,)]
    steps(folder, s0002_bad=SECOND)
    assert open_and_close(path, folder) == [2]


def test_a_newer_store_is_refused_in_words(tmp_path: Path) -> None:
    folder, path = steps(tmp_path / "steps", s0001_first=FIRST, s0002_second=SECOND), tmp_path / "x.db"
    open_and_close(path, folder)
    (folder / "0002_second.sql").unlink()
    with pytest.raises(StoreError, match=r"written by a newer version of Lineside \(its step 0002 second"):
        Database(path, folder)
    assert rows(path) == [(1, 7)]


def test_every_migration_has_a_different_number() -> None:
    numbers = [step.number for step in migrations_in(MIGRATIONS)]
    assert numbers[:2] == [1, 2]
    assert len(set(numbers)) == len(numbers)


async def test_a_new_store_is_one_event_without_its_steps(tmp_path: Path) -> None:
    for _ in range(2):
        async with complete_app(tmp_path) as house:
            events = await house.events("server")
    made = [event for event in events if event["messages"]["what"].code.startswith("event_store")]
    assert [event["what"] for event in made] == ["store created"]


async def test_what_was_kept_of_a_secret_is_overwritten(tmp_path: Path) -> None:
    """Results by key and rows of restores held #21; the keys remain refused to every sender."""
    before = tmp_path / "before"
    before.mkdir()
    for step in MIGRATIONS.glob("00[0-2]*.sql"):
        shutil.copy(step, before)
    path, kept = tmp_path / "lineside.db", b'{"is":"result","units":[{"unit":1,"read_back":73195}]}'
    with closing(Database(path, before)) as old:
        old.write_now(lambda c: c.execute("INSERT INTO asked VALUES ('mine', 1.0, 'x', ?)", (kept,)))
        for row in (
            "restore VALUES ('r', 'b', 1, 'u', 'w', 1.0, 0, 'equal', '')",
            "restore_row VALUES ('r', 0, 21, 73195, 73196, 'verified', '', 73196)",
            "restore_row VALUES ('r', 1, 6, 50, 51, 'verified', '', 51)",
            "restore_value VALUES ('r', 'wanted', 21, 73196, 1, NULL)",
        ):
            old.write_now(lambda c, row=row: c.execute(f"INSERT INTO {row}"))  # type: ignore[misc]
    with closing(Database(path)) as new:
        restore = await RestoreStore(new).load("r")
        known = new.read_now(lambda c: record.find_key(c, "anna 0.0", "mine"))
    assert restore is not None
    assert [(row.write.present, row.write.wanted, row.read_back) for row in restore.rows] == [
        (-1, -1, None),
        (50, 51, 51),
    ]
    assert restore.wanted.raw(21) is None
    assert known is not None
    assert (known.digest, known.result.outcome) == ("", "unverified")
    assert b"73195" not in path.read_bytes(), "nor in a free page"


async def test_the_texts_of_an_earlier_version_stay_as_they_were(tmp_path: Path) -> None:
    before = tmp_path / "before"
    before.mkdir()
    for step in MIGRATIONS.glob("00[0-5]*.sql"):
        shutil.copy(step, before)
    path, texts = tmp_path / "lineside.db", ['it said "no"', "nothing answers\na unit answers", ""]
    with closing(Database(path, before)) as old:
        for row in (
            "restore VALUES ('r', 'b', 1, 'u', 'w', 1.0, 0, 'stopped', :0, NULL)",
            "restore_row VALUES ('r', 0, 6, 50, 51, 'refused', :0, 51)",
            "restore_row VALUES ('r', 1, 7, 50, 51, 'verified', :2, 51)",
            "restore_left_out VALUES ('r', 8, :0, 0, NULL)",
            "swap VALUES ('b', 1, 'w', 1.0, NULL, NULL, 1, 0, NULL, :1)",
            "swap VALUES ('b', 2, 'w', 1.0, NULL, NULL, 1, 0, NULL, :2)",
        ):
            values = {str(place): text for place, text in enumerate(texts)}
            old.write_now(lambda c, row=row, values=values: c.execute(f"INSERT INTO {row}", values))  # type: ignore[misc]

    def stored(table: str, column: str) -> list[list[str]]:
        query = f"SELECT {column} FROM {table}"
        found = new.read_now(lambda c: [row[0] for row in c.execute(query)])
        return [[str(message) for message in messages_of(text)] for text in found]

    with closing(Database(path)) as new:
        assert stored("swap", "seen") == [texts[1].split("\n"), []]
        restore = await RestoreStore(new).load("r")
    assert restore is not None
    assert str(restore.cause) == texts[0]
    assert [row.message and str(row.message) for row in restore.rows] == [texts[0], None]
    assert [str(left.text) for left in restore.left_out] == [texts[0]]


async def test_a_restore_of_an_earlier_version_stays_as_it_was(tmp_path: Path) -> None:
    before, path = tmp_path / "before", tmp_path / "lineside.db"
    before.mkdir()
    for step in MIGRATIONS.glob("*.sql"):
        if int(step.name[:4]) < 120:
            shutil.copy(step, before)
    stopped = stored_messages([Message.of("restore_left_off", who="ben", done=1, n=2)])
    rows = (
        ("restore", ("r", "b", 2, "Nip", "anna", 1000.25, 36, "stopped", stopped, "cancelled")),
        ("restore_row", ("r", 1, 7, 50, 60, "not_sent", "[]", None)),
        ("restore_row", ("r", 0, 6, 0, 50, "refused", "{", 40)),
        ("restore_left_out", ("r", 17, stored_messages([Message("row_address")]), 0, "address")),
        ("restore_left_out", ("r", 12, "[]", 1, None)),
        ("restore_value", ("r", "wanted", 6, 50, 1, 999.5)),
        ("restore_value", ("r", "before", 6, 0, 1, None)),
        ("restore_value", ("r", "before", 30, None, 0, None)),
        ("restore", ("s", "b", 2, "Nip", "anna", 1001.0, 40, "running", "[]", None)),
    )
    with closing(Database(path, before)) as old:
        for table, row in rows:
            insert = f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})"
            old.write_now(lambda c, insert=insert, row=row: c.execute(insert, row))  # type: ignore[misc]
    with closing(Database(path)) as new:
        later, restore = await RestoreStore(new).of_unit("b", 2)
        assert [one.id for one in await RestoreStore(new).under_way()] == ["s"]
    address, remote = LeftOut(17, "address", Message("row_address")), LeftOut(12, "not_in_remote", UNREADABLE)
    assert (later.state, later.rows, later.plan, later.proven) == (
        "running",
        [],
        RestorePlan((), (), 40),
        None,
    )
    assert (restore.who, restore.planned_at, restore.state) == ("anna", 1000.25, "stopped")
    assert (str(restore.cause), restore.cause_code) == ("canceled by ben after 1 of 2 rows", "cancelled")
    assert restore.rows == [
        RowResult(Write(6, 0, 50), "refused", None, 40),
        RowResult(Write(7, 50, 60), "not_sent"),
    ]
    assert restore.plan == RestorePlan((Write(6, 0, 50), Write(7, 50, 60)), (remote, address), 36)
    assert restore.wanted == UnitRows(2, "Nip", {6: ParameterRow(6, 50, read_at=999.5)})
    assert restore.before.rows == {6: ParameterRow(6, 0), 30: ParameterRow(30, None, available=False)}


def test_a_stored_text_that_is_no_message_is_shown_as_that() -> None:
    assert messages_of("{") == messages_of('[{"code": 7}]') == [UNREADABLE]
    kept = [Message.of("at_row", number=3, why=Message("row_secret"))]
    assert messages_of(stored_messages(kept)) == kept


def test_an_alarm_that_waits_from_before_has_the_time_at_which_it_cleared(tmp_path: Path) -> None:
    before = tmp_path / "before"
    before.mkdir()
    for step in MIGRATIONS.glob("*.sql"):
        if int(step.name[:4]) < 117:
            shutil.copy(step, before)
    path = tmp_path / "x.db"
    open_and_close(path, before)
    with closing(sqlite3.connect(path)) as connection, connection:
        for alarm, active, acknowledged in (("waits", 0, 0), ("active", 1, 0), ("normal", 0, 1)):
            connection.execute(
                "INSERT INTO alarm_facts"
                " VALUES (?, ?, ?, 0, 0, 0, NULL, 0, 1, 20.0, 10.0, NULL, 0, '', '', 0)",
                (alarm, active, acknowledged),
            )
    open_and_close(path, MIGRATIONS)
    with closing(sqlite3.connect(path)) as connection:
        found = connection.execute("SELECT alarm, came, cleared FROM alarm_facts ORDER BY alarm").fetchall()
    assert found == [("active", 10.0, None), ("normal", 10.0, None), ("waits", 10.0, 20.0)]


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_newest_two_stay_with_their_companions(tmp_path: Path) -> None:
    store = tmp_path / "x.db"
    store.touch()
    (tmp_path / "y.db.damaged-20250101T000000Z").touch()
    copy_of(store, "before", "0001").touch()
    for day in range(1, 5):
        for suffix in ("", "-wal"):
            copy_of(store, "damaged", f"2026010{day}T000000Z{suffix}").touch()
    remove_older_copies(store, "damaged")
    assert names_in(tmp_path) == [
        "x.db",
        "x.db.before-0001",
        *(f"x.db.damaged-2026010{day}T000000Z{suffix}" for day in (3, 4) for suffix in ("", "-wal")),
        "y.db.damaged-20250101T000000Z",
    ]


def test_one_that_cannot_be_removed_stays_and_is_logged(tmp_path: Path) -> None:
    store = tmp_path / "x.db"
    for label in ("1", "2", "3", "4"):
        copy_of(store, "before", label).touch()
    copy_of(store, "before", "1").unlink()
    copy_of(store, "before", "1").mkdir()
    with capture_logs() as logs:
        remove_older_copies(store, "before")
    assert names_in(tmp_path) == ["x.db.before-1", "x.db.before-3", "x.db.before-4"]
    assert [entry["path"] for entry in logs] == [str(copy_of(store, "before", "1"))]


def test_each_step_leaves_the_newest_two(tmp_path: Path) -> None:
    steps = tmp_path / "steps"
    steps.mkdir()
    for number in range(1, 6):
        (steps / f"{number:04d}_step.sql").write_text(f"CREATE TABLE t{number} (x INTEGER);\n")
        Database(tmp_path / "x.db", steps).close()
    assert [path.name for path in sorted(tmp_path.glob("x.db.*-*"))] == [
        "x.db.before-0004",
        "x.db.before-0005",
    ]


def test_a_store_put_aside_again_and_again_leaves_the_newest_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "history.db"
    for minute in range(4):
        stamp = f"20260101T00{minute:02d}00Z"
        monkeypatch.setattr(copies.time, "strftime", lambda *_, stamp=stamp: stamp)
        store.write_text(stamp)
        assert put_aside(store).read_text() == stamp
    assert names_in(tmp_path) == [f"history.db.damaged-20260101T00{minute:02d}00Z" for minute in (2, 3)]


STORE, KEY = Path("/data/lineside.db"), Path("/etc/lineside.audit.key")


@for_each(
    ("presence", "key", "code"),
    [
        ("sound", KEY, None),
        ("sound", None, None),
        ("missing", None, None),
        ("empty", None, None),
        ("missing", KEY, "store_missing_at_start"),
        ("empty", KEY, "store_empty_at_start"),
        ("damaged", KEY, "store_damaged_at_start"),
        ("damaged", None, "store_damaged_at_start"),
    ],
)
def test_a_site_that_was_there_is_not_replaced(
    presence: Presence, key: Path | None, code: str | None
) -> None:
    refusal = refusal_to_start(str(STORE), presence, key, new=False)
    assert (refusal and refusal.code) == code
    assert refusal is None or "lineside serve --new" in str(refusal)


@for_each("key", [None, KEY])
@for_each(
    ("presence", "code"), [("sound", "store_not_new"), ("missing", None), ("empty", None), ("damaged", None)]
)
def test_a_new_site_is_begun_where_none_can_be_used(
    presence: Presence, code: str | None, key: Path | None
) -> None:
    refusal = refusal_to_start(str(STORE), presence, key, new=True)
    assert (refusal and refusal.code) == code


@pytest.fixture
def store(tmp_path: Path) -> Path:
    path = tmp_path / "data" / "lineside.db"
    Database(path).close()
    return path


def files_beside(store: Path) -> set[str]:
    return {path.name for path in store.parent.iterdir()}


def test_a_store_is_read_and_no_file_is_made(store: Path) -> None:
    before = files_beside(store)
    assert presence_of(store) == "sound"
    with examining(store) as connection:
        assert connection.execute("SELECT count(*) FROM events").fetchone()[0] == 0
    assert files_beside(store) == before


def test_a_store_that_a_server_has_open_is_read_with_its_log(store: Path) -> None:
    database = Database(store)
    database.write_now(lambda connection: connection.execute("CREATE TABLE newest (a)"))
    try:
        with examining(store) as connection:
            assert connection.execute("SELECT count(*) FROM newest").fetchone()[0] == 0
    finally:
        database.close()


def test_what_else_is_in_its_place(store: Path) -> None:
    size = store.stat().st_size
    os.truncate(store, size // 2)
    assert presence_of(store) == "damaged"
    os.truncate(store, 0)
    assert presence_of(store) == "empty"
    store.write_bytes(b"no store " * 1000)
    assert presence_of(store) == "damaged"
    store.unlink()
    assert presence_of(store) == "missing"
    assert presence_of(store.parent.parent / "unmounted" / "lineside.db") == "missing"


def test_a_link_is_not_followed(store: Path, tmp_path: Path) -> None:
    (tmp_path / "link.db").symlink_to(store)
    with pytest.raises(StoreError, match="link"):
        presence_of(tmp_path / "link.db")
