"""A connection to PostgreSQL that takes the SQL of features."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any
from weakref import WeakSet

import psycopg
from psycopg import RawCursor
from psycopg.conninfo import make_conninfo

from app.database.postgresql.rows import NamedRow, named_row
from app.database.postgresql.translation import translated
from app.database.postgresql.values import ADAPTERS
from app.database.settings import StoreSettings
from app.errors import StoreError, system_error
from bus.messages import Message

CONNECT_S = 5
LOST_MS = 5000
"""How long data may go unacknowledged until the connection is taken for lost."""
DEFAULTS = {
    "connect_timeout": CONNECT_S,
    "keepalives_idle": 2,
    "keepalives_interval": 1,
    "keepalives_count": 3,
    "tcp_user_timeout": LOST_MS,
    "application_name": "lineside",
}

_open: WeakSet[psycopg.Connection[NamedRow]] = WeakSet()


class PostgresqlConnection:
    """Translates each statement; rows are by index and by name."""

    def __init__(self, driver: psycopg.Connection[NamedRow]) -> None:
        self.driver = driver

    def execute(self, sql: str, parameters: Any = (), /) -> RawCursor[NamedRow]:
        statement = translated(sql)
        cursor = RawCursor(self.driver, row_factory=named_row)
        return cursor.execute(statement.sql, statement.values(parameters), binary=True)

    def executemany(self, sql: str, rows: Iterable[Any], /) -> RawCursor[NamedRow]:
        statement = translated(sql)
        cursor = RawCursor(self.driver, row_factory=named_row)
        cursor.executemany(statement.sql, [statement.values(row) for row in rows])
        return cursor


def name_of(store: StoreSettings, schema: str) -> str:
    """Names a store in messages."""
    return f"{store.shown} ({schema})"


def connection_string(store: StoreSettings, bounds: Mapping[str, int] | None = None) -> str:
    """All that libpq needs, also what is secret. ``bounds`` count more than those of the configuration.
    Raises StoreError where a password file cannot be read."""
    given: dict[str, Any] = psycopg.conninfo.conninfo_to_dict(store.url)
    secret = {} if store.password_file is None else {"password": _password(store)}
    return make_conninfo("", **{**DEFAULTS, **given, **secret, **(bounds or {})})


def connect(
    store: StoreSettings, schema: str, bounds: Mapping[str, int] | None = None, /, **options: str | int
) -> psycopg.Connection[NamedRow]:
    """A connection in autocommit whose statements mean the tables of a schema. ``bounds``: of the connection;
    ``options``: settings of the session. Raises psycopg.Error, StoreError."""
    session: Mapping[str, str | int] = {
        "search_path": schema,
        "client_encoding": "utf8",
        **options,
    }
    connection: psycopg.Connection[NamedRow] = psycopg.connect(
        connection_string(store, bounds), autocommit=True, row_factory=named_row, context=_Adapted()
    )
    _open.add(connection)
    try:
        for name, value in session.items():
            connection.execute("SELECT set_config(%s, %s, false)", (name, str(value)))
    except BaseException:
        connection.close()
        raise
    return connection


def interrupt_all() -> None:
    """End every wait of this process for a database that does not respond: the process could not end before.
    Each raises StoreUnavailableError."""
    for connection in tuple(_open):
        with suppress(psycopg.Error, OSError), socket.socket(fileno=os.dup(connection.fileno())) as wire:
            wire.shutdown(socket.SHUT_RDWR)


class _Adapted:
    """Where psycopg looks for the adapters of a connection."""

    adapters = ADAPTERS
    connection = None


def _password(store: StoreSettings) -> str:
    assert store.password_file is not None
    try:
        lines = store.password_file.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        why = system_error(error)
        failed = Message.of("store_password_unreadable", path=str(store.password_file), error=why)
        raise StoreError(failed) from error
    return lines[0] if lines else ""
