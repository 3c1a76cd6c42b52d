"""A store in PostgreSQL: what it shares with other servers, and words for what goes wrong."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from app.database import Database, StoreConnection
from app.database.engine import clock, lock, notify
from app.database.opening import open_database
from app.database.settings import StoreSettings
from app.errors import ConstraintError, StoreError, StoreUnavailableError, TooCostlyError
from bus.errors import CallerError
from bus.instants import unix_now
from tests.postgresql import (
    GUARDED,
    PASSWORD,
    SCHEMAS,
    fresh_database,
    fresh_store,
    needs_postgresql,
    socket_folder,
    url_of,
)

psycopg = pytest.importorskip("psycopg")
PostgresqlDatabase = pytest.importorskip("app.database.postgresql.database").PostgresqlDatabase
WRITING = pytest.importorskip("app.database.postgresql.database").WRITING
LOCK = pytest.importorskip("app.database.postgresql.migrating").LOCK
connection_string = pytest.importorskip("app.database.postgresql.connection").connection_string
pytestmark = needs_postgresql
FILE = Path("lineside.db")
WITHIN_S = 10.0


@pytest.fixture(scope="module")
def shared() -> Iterator[Database]:
    """An empty store that no test changes."""
    with fresh_store() as database:
        yield database


@pytest.fixture
def store() -> Iterator[StoreSettings]:
    with fresh_database() as settings:
        yield settings


@pytest.fixture
def empty() -> Iterator[StoreSettings]:
    with fresh_database(empty=True) as settings:
        yield settings


def opened(store: StoreSettings) -> contextlib.closing[Database]:
    return closing(open_database(store, FILE))


def one(connection: StoreConnection, query: str, *values: Any) -> Any:
    return connection.execute(query, values).fetchone()[0]


def note(connection: StoreConnection, bus: str, minute: int = 0) -> None:
    connection.execute("INSERT INTO set_schedule VALUES (?, ?)", (bus, minute))


def test_values_are_those_of_sqlite(shared: Database) -> None:
    def read(connection: StoreConnection) -> Any:
        return connection.execute(
            "SELECT ? AS number, CAST(? AS REAL) AS real, ? AS truth, CAST(? AS BYTEA) AS bytes,"
            " 1 = 1 AS is_so, (SELECT sum(number) FROM migrations WHERE number < 3) AS total",
            (2**62, 1.5, True, b"\0\xff"),
        ).fetchone()

    row = shared.read_now(read)
    found = {"number": 2**62, "real": 1.5, "truth": 1, "bytes": b"\0\xff", "is_so": 1, "total": 3}
    assert dict(row) == found
    assert [type(value) for value in row] == [int, float, int, bytes, int, int]
    assert (row["real"], row[1]) == (1.5, 1.5)


def test_a_number_or_a_text_that_no_column_holds(shared: Database) -> None:
    with pytest.raises(CallerError, match="a number is too large"):
        shared.read_now(lambda c: one(c, "SELECT ?", 2**63))
    with pytest.raises(CallerError, match="character of code 0"):
        shared.read_now(lambda c: one(c, "SELECT ?", "a\0b"))


async def test_a_read_that_takes_too_long_is_ended(shared: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.database.postgresql.database.COSTLY_S", 0.05)
    with pytest.raises(TooCostlyError):
        await shared.read_costly(lambda c: one(c, "SELECT pg_sleep(20)"))


def test_a_reader_cannot_write(shared: Database) -> None:
    with pytest.raises(StoreError, match="which cannot be written"):
        shared.read_now(lambda c: note(c, "dry-end"))


def test_a_failed_statement_ends_its_transaction(store: StoreSettings) -> None:
    def caught(connection: StoreConnection) -> None:
        note(connection, "dry-end")
        with contextlib.suppress(Exception):
            note(connection, "dry-end", 5)

    with opened(store) as database:
        with pytest.raises(StoreError, match="nothing was stored: a statement before it had failed"):
            database.write_now(caught)
        assert database.read_now(lambda c: one(c, "SELECT count(*) FROM set_schedule")) == 0
        with pytest.raises(ConstraintError):
            database.write_now(lambda c: note(c, "dry-end", 5000))


def test_many_servers_that_start_at_once_make_the_tables_once(empty: StoreSettings) -> None:
    def start(_: int) -> int:
        with opened(empty) as database:
            return len(database.migrated)

    with ThreadPoolExecutor(4) as together:
        steps = sorted(together.map(start, range(4)))
    assert steps[:-1] == [0, 0, 0]
    assert steps[-1] > 20


def test_a_name_is_locked_to_the_end_of_the_transaction(store: StoreSettings) -> None:
    order: list[str] = []
    waiting = "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"

    def first(connection: StoreConnection) -> None:
        lock(connection, "chain")
        other.submit(second_server.write_now, second)
        while not one(connection, waiting):
            time.sleep(0.01)
        order.append("first")

    def second(connection: StoreConnection) -> None:
        lock(connection, "chain")
        order.append("second")

    with opened(store) as first_server, opened(store) as second_server, ThreadPoolExecutor(1) as other:
        first_server.write_now(first)
    assert order == ["first", "second"]


def test_a_start_waits_for_another_only_so_long(
    store: StoreSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(WRITING, "lock_timeout", 100)
    with opened(store) as held:
        held.write_now(lambda c: c.execute("SELECT pg_advisory_lock(?)", (LOCK,)))
        with pytest.raises(StoreUnavailableError, match="another server changes the same"):
            open_database(store, FILE)


def test_the_clock_is_that_of_the_database(shared: Database) -> None:
    assert abs(shared.read_now(clock) - unix_now()) < WITHIN_S


async def test_every_server_gets_the_texts_of_a_committed_transaction(store: StoreSettings) -> None:
    texts: asyncio.Queue[str] = asyncio.Queue()

    def announce(connection: StoreConnection) -> None:
        notify(connection, "rights", "anna")

    def fail(connection: StoreConnection) -> None:
        notify(connection, "rights", "never")
        raise ValueError("midway")

    with opened(store) as here, opened(store) as there:
        here.listen("rights", texts.put_nowait)
        async with asyncio.timeout(WITHIN_S):
            await listening(there)
            with pytest.raises(ValueError, match="midway"):
                await there.write(fail)
            await there.write(announce)
            assert await texts.get() == "anna"
            await there.write(end_other_connections)
            assert await texts.get() == ""
            await there.write(announce)
            assert await texts.get() == "anna"
        await asyncio.to_thread(here.close)


async def listening(database: Database) -> None:
    """Wait until a connection of another server listens."""
    query = (
        "SELECT count(*) FROM pg_stat_activity"
        " WHERE query LIKE 'LISTEN%' AND state = 'idle' AND datname = current_database()"
    )
    while not await database.read(lambda c: one(c, query)):  # noqa: ASYNC110
        await asyncio.sleep(0.02)


def end_other_connections(connection: StoreConnection) -> None:
    connection.execute(
        "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity"
        " WHERE datname = current_database() AND pid <> pg_backend_pid()"
    )


def test_a_lost_connection_is_opened_again(store: StoreSettings) -> None:
    with opened(store) as database, opened(store) as other:
        assert database.read_now(lambda c: one(c, "SELECT 1")) == 1
        other.write_now(end_other_connections)
        assert database.read_now(lambda c: one(c, "SELECT 2")) == 2
        database.write_now(lambda c: note(c, "dry-end"))


def test_a_connection_that_could_not_be_opened_again_is_opened_later(
    store: StoreSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise psycopg.OperationalError("no route to host")

    def select(connection: StoreConnection) -> Any:
        return one(connection, "SELECT 1")

    with opened(store) as database, opened(store) as other:
        works = (database.read_now, database.write_now, database.write_briefly_now, database._read_within)
        assert [work(select) for work in works] == [1, 1, 1, 1]
        other.write_now(end_other_connections)
        with monkeypatch.context() as patch:
            patch.setattr("app.database.postgresql.database.connect", refuse)
            for work in (*works, *works):
                with pytest.raises(StoreUnavailableError, match="no route to host"):
                    work(select)
        assert [work(select) for work in works] == [1, 1, 1, 1]


def test_a_database_of_a_newer_version(empty: StoreSettings) -> None:
    newer = "INSERT INTO migrations VALUES (9000, 'future', 0.0)"
    with opened(empty) as database:
        database.write_now(lambda c: c.execute(newer))
    with pytest.raises(StoreError, match="written by a newer version of Lineside") as refused:
        open_database(empty, FILE)
    assert "step 9000 future" in str(refused.value)


def test_a_later_step_is_taken_completely_or_not_at_all(empty: StoreSettings, tmp_path: Path) -> None:
    (tmp_path / "0001_things.sql").write_text(
        "CREATE TABLE things (id INTEGER PRIMARY KEY, name TEXT) STRICT;"
    )
    with closing(open_database(empty, Path("things.db"), tmp_path)) as database:
        assert [step.number for step in database.migrated] == [1]
    (tmp_path / "0002_more.sql").write_text(
        "-- With a semicolon; in a comment.\nALTER TABLE things ADD COLUMN data BLOB;\n"
        "CREATE TRIGGER things_stay BEFORE DELETE ON things\n"
        "BEGIN SELECT RAISE(ABORT, 'it stays; always'); END;\n"
        "INSERT INTO things (name) VALUES ('a;b');\n"
    )
    with closing(open_database(empty, Path("things.db"), tmp_path)) as database:
        assert [step.name for step in database.migrated] == ["more"]
        assert database.read_now(lambda c: one(c, "SELECT name FROM things")) == "a;b"
        for change in ("DELETE FROM things", "TRUNCATE things"):
            with pytest.raises(ConstraintError, match="it stays; always"):
                database.write_now(lambda c, change=change: c.execute(change))  # type: ignore[misc]
    (tmp_path / "0003_wrong.sql").write_text("DROP TABLE things;\nALTER TABLE nothing ADD COLUMN a TEXT;\n")
    with pytest.raises(StoreError, match="step 0003 wrong failed"):
        open_database(empty, Path("things.db"), tmp_path)
    with pytest.raises(StoreError, match="step 0003 wrong failed"):
        open_database(empty, Path("things.db"), tmp_path)


TABLES = """
SELECT table_name, column_name, data_type, is_nullable, column_default, collation_name, is_identity
FROM information_schema.columns WHERE table_schema = current_schema() ORDER BY 1, 2
"""
RULES = """
SELECT event_object_table, event_manipulation, action_condition, action_statement
FROM information_schema.triggers WHERE trigger_schema = current_schema() ORDER BY 1, 2, 3, 4
"""
INDEXES = r"""
SELECT tablename, regexp_replace(indexdef, 'INDEX \w+ ON', 'INDEX ON') FROM pg_indexes
WHERE schemaname = current_schema() ORDER BY 1, 2
"""
BEFORE = {"main": 130, "history": 2, "pictures": 2}
"""The last step before PostgreSQL was an engine: each further one is taken by both."""


@pytest.mark.parametrize("schema", SCHEMAS)
def test_steps_lead_to_the_tables_of_a_new_store(empty: StoreSettings, tmp_path: Path, schema: str) -> None:
    def described(connection: StoreConnection) -> list[list[tuple[Any, ...]]]:
        queries = (TABLES, RULES, INDEXES)
        return [[tuple(row) for row in connection.execute(query)] for query in queries]

    for step in SCHEMAS[schema].glob("*.sql"):
        if int(step.name[:4]) <= BEFORE[schema]:
            shutil.copy(step, tmp_path)
    stepped = Path(f"{schema}.db")
    open_database(empty, stepped, tmp_path).close()
    with closing(PostgresqlDatabase(empty, schema, SCHEMAS[schema])) as database:
        stepped_to = database.read_now(described)
    with fresh_store(schema) as database:
        assert stepped_to == database.read_now(described)


def test_an_unreachable_host() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    store = StoreSettings(url=f"postgresql://lineside:geheim@127.0.0.1:{port}/lineside")
    with pytest.raises(
        StoreUnavailableError, match=r"it cannot be reached: .*check \[store\] url"
    ) as refused:
        open_database(store, FILE)
    assert "geheim" not in str(refused.value)


def test_a_database_that_is_not_there() -> None:
    with pytest.raises(StoreError, match='database "nowhere" does not exist'):
        open_database(StoreSettings(url=url_of("nowhere")), FILE)


@pytest.mark.parametrize("password", ["wrong password", None])
def test_a_password_that_is_wrong_or_missing(
    store: StoreSettings, tmp_path: Path, password: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PGPASSFILE", str(tmp_path / "none"))
    url = store.url.replace("lineside@", f"{GUARDED}@" if password is None else f"{GUARDED}:{password}@")
    with pytest.raises(StoreUnavailableError, match=r"it refuses the user: .*check the user") as refused:
        open_database(StoreSettings(url=url.replace(" ", "%20")), FILE)
    assert not password or password not in str(refused.value)


def test_a_password_file(store: StoreSettings, tmp_path: Path) -> None:
    file = tmp_path / "db.password"
    guarded = StoreSettings(url=store.url.replace("lineside@", f"{GUARDED}@"), password_file=file)
    with pytest.raises(StoreError, match="the password of the store cannot be read"):
        open_database(guarded, FILE)
    file.write_text(f"{PASSWORD}\n")
    with opened(guarded) as database:
        assert database.read_now(lambda c: one(c, "SELECT current_user")) == GUARDED


def test_a_user_may_own_the_schemas_alone(empty: StoreSettings) -> None:
    with psycopg.connect(empty.url, autocommit=True) as admin:
        admin.execute("CREATE ROLE owner_of_schemas LOGIN")
        admin.execute("CREATE SCHEMA main AUTHORIZATION owner_of_schemas")
    owned = StoreSettings(url=empty.url.replace("lineside@", "owner_of_schemas@"))
    with opened(owned) as database:
        assert len(database.migrated) > 20
        database.write_now(lambda c: note(c, "dry-end"))


def test_a_database_of_another_encoding(empty: StoreSettings) -> None:
    with psycopg.connect(empty.url, autocommit=True) as admin:
        admin.execute("CREATE DATABASE ascii TEMPLATE template0 ENCODING 'SQL_ASCII'")
    with pytest.raises(StoreError, match="has the encoding SQL_ASCII"):
        open_database(StoreSettings(url=url_of("ascii")), FILE)


def test_every_parameter_of_the_url_reaches_libpq() -> None:
    url = "postgresql://anna@a:5433,b:5434/x?sslmode=verify-full&sslrootcert=/ca.pem&connect_timeout=2"
    found = psycopg.conninfo.conninfo_to_dict(connection_string(StoreSettings(url=url)))
    assert (found["host"], found["port"]) == ("a,b", "5433,5434")
    assert (found["sslmode"], found["sslrootcert"]) == ("verify-full", "/ca.pem")
    assert (found["connect_timeout"], found["tcp_user_timeout"]) == ("2", "5000")


def test_a_role_without_rights(empty: StoreSettings) -> None:
    with closing(open_database(empty, FILE)) as admin:
        admin.write_now(lambda c: c.execute(f'CREATE ROLE "{admin.name[-20:]}" LOGIN'))
        role = admin.name[-20:]
    url = empty.url.replace("lineside@", f"{role.replace(' ', '%20')}@")
    try:
        with pytest.raises(StoreError, match="the user of \\[store\\] url lacks rights"):
            open_database(StoreSettings(url=url), FILE)
    finally:
        with closing(open_database(empty, FILE)) as admin:
            admin.write_now(lambda c: c.execute(f'DROP ROLE "{role}"'))


def test_a_standby_cannot_be_brought_up_to_date(empty: StoreSettings) -> None:
    read_only = StoreSettings(url=f"{empty.url}&options=-c%20default_transaction_read_only%3Don")
    with pytest.raises(StoreUnavailableError, match="it is a standby"):
        open_database(read_only, FILE)


def test_the_driver_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("app.database.opening.find_spec", lambda _: None)
    with pytest.raises(StoreError, match=r"pip install lineside\[postgresql\]"):
        open_database(StoreSettings(url="postgresql://db/lineside"), tmp_path / "x.db")


def test_the_server_of_the_tests_is_reached_by_a_socket() -> None:
    assert (socket_folder() / "ready").exists()
