"""Bringing a store of PostgreSQL up to date, alone among all servers."""

from __future__ import annotations

from pathlib import Path

import psycopg
from psycopg.sql import SQL, Identifier

from app.database.migration import Migration, failed_step, missing_in
from app.database.postgresql.connection import PostgresqlConnection
from app.database.postgresql.rows import NamedRow
from app.database.postgresql.schema import FUNCTIONS, definition, split, statements_of
from app.database.unfinished import LEDGER
from app.errors import StoreError, StoreUnavailableError
from bus.instants import unix_now
from bus.messages import Message

LOCK = 0x4C494E45
"""Held by the server that makes or changes the tables of a database."""
_RECORD = "INSERT INTO migrations VALUES (?, ?, ?)"


def bring_up_to_date(
    driver: psycopg.Connection[NamedRow], schema: str, folder: Path, name: str
) -> list[Migration]:
    """Make the tables of a store, or apply the steps that it lacks, each completely or not at all; return the
    steps. ``driver`` is in autocommit. Raises StoreError, psycopg.Error."""
    # The lock is for a look, too: another server may be in the middle of the first step.
    driver.execute("SELECT pg_advisory_lock(%s)", (LOCK,))
    try:
        applied = _applied(driver, schema)
        missing = missing_in(applied, folder, name)
        if missing and driver.execute("SELECT pg_is_in_recovery()").fetchone() == (1,):
            raise StoreUnavailableError(
                Message.of("store_failed", path=name, reason=Message("store_is_standby"))
            )
        if not applied:
            _make(driver, schema, folder, missing, name)
        else:
            for step in missing:
                _apply(driver, step, name)
        return missing
    finally:
        if not driver.closed:
            driver.execute("SELECT pg_advisory_unlock(%s)", (LOCK,))


def is_unfinished(driver: psycopg.Connection[NamedRow], schema: str) -> bool:
    """Whether the store is a copy that is not finished."""
    return driver.execute("SELECT to_regclass(%s)", (f"{schema}.{LEDGER}",)).fetchone() != (None,)


def _applied(driver: psycopg.Connection[NamedRow], schema: str) -> dict[int, str]:
    if driver.execute("SELECT to_regclass(%s)", (f"{schema}.migrations",)).fetchone() == (None,):
        return {}
    return dict(driver.execute("SELECT number, name FROM migrations").fetchall())


def _make(
    driver: psycopg.Connection[NamedRow], schema: str, folder: Path, steps: list[Migration], name: str
) -> None:
    """All tables at once, as the steps would leave them."""
    encoding = driver.info.parameter_status("server_encoding")
    if encoding != "UTF8":
        raise StoreError(Message.of("store_encoding", path=name, encoding=str(encoding)))
    with driver.transaction():
        # A user who owns the schema alone may not make one, not even one that is there.
        if driver.execute("SELECT to_regnamespace(%s)", (schema,)).fetchone() == (None,):
            driver.execute(SQL("CREATE SCHEMA {}").format(Identifier(schema)))
        driver.execute(f"{FUNCTIONS};{';'.join(statements_of(folder))}".encode())
        _record(driver, steps)


def _apply(driver: psycopg.Connection[NamedRow], step: Migration, name: str) -> None:
    try:
        with driver.transaction():
            driver.execute(FUNCTIONS.encode())
            for statement in split(step.sql):
                for each in definition(statement):
                    driver.execute(each.encode())
            _record(driver, [step])
    except (psycopg.ProgrammingError, psycopg.DataError, psycopg.IntegrityError, ValueError) as error:
        raise failed_step(step, name, error) from error


def _record(driver: psycopg.Connection[NamedRow], steps: list[Migration]) -> None:
    rows = [(step.number, step.name, float(unix_now())) for step in steps]
    PostgresqlConnection(driver).executemany(_RECORD, rows)
