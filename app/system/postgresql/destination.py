"""The connection to the plant's database: it makes the tables, sends batches of rows, and reports failures in
words.

The events there are a second witness of the audit log: :func:`compare` compares the two.
"""

from __future__ import annotations

import os
import re
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from app.core.database import StoreConnection
from app.core.server.settings import SecretFileError, read_secret_text
from app.errors import StoreError
from app.people.audit.proof import cuts_of
from app.system.postgresql.rows import (
    ALARM,
    BIT_COLUMNS,
    EVENT,
    MINUTE_TABLE,
    READING,
    UNIT,
    Batch,
    Row,
    Table,
    instant,
    unit_row,
)
from app.system.postgresql.settings import PostgresqlSettings
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.settings import BusSettings

if TYPE_CHECKING:
    import psycopg

CONNECT_S = 10
STATEMENT_S = 60
SILENCE_S = 30
"""The time after which a database that does not respond is given up."""
OPTIONS = " ".join(
    f"-c {name}={value}"
    for name, value in {
        "statement_timeout": f"{STATEMENT_S}s",
        "timezone": "UTC",
        "client_min_messages": "error",
        # The cursor moves past committed rows: these must outlive a crash of the database.
        "synchronous_commit": "on",
    }.items()
)
BEGINNING = instant(0)
"""The ``valid_from`` of the first names of a unit, as its past may be filled in later."""
MARK = "lineside_version"
"""The table that marks a schema as one of Lineside's."""
VERSION = 1
"""The version of the tables."""
MONTHLY: tuple[Table, ...] = (READING, MINUTE_TABLE, EVENT, ALARM)
_TYPES = {
    "id": "bigint NOT NULL",
    "occurrence": "bigint NOT NULL",
    "count": "bigint",
    "about": "bigint",
    "unit": "integer",
    "decimals": "smallint",
    "old_raw": "bigint",
    "new_raw": "bigint",
    **dict.fromkeys(("at", "came", "valid_from"), "timestamptz NOT NULL"),
    **dict.fromkeys(("cleared", "acknowledged"), "timestamptz"),
    **dict.fromkeys(("commanded", "actual", "analog"), "double precision"),
    **dict.fromkeys(("actual_min", "actual_avg", "actual_max"), "double precision"),
    **dict.fromkeys(("known_s", "run_s", "at_speed_s", "length"), "double precision"),
    **dict.fromkeys(BIT_COLUMNS, "boolean"),
}
"""The type of each column that is not text."""
_MONTH = re.compile(r"_y(\d{4})m(\d{2})$")
_NAMES = ("site", UNIT.name, *(table.name for table in MONTHLY), "unit_now")


class PublishError(StoreError):
    """Raised if the plant's database cannot be reached or takes no rows; the message has the reason."""


class SchemaError(StoreError):
    """Raised if the plant's database cannot take the published rows; the message has the remedy."""


def require_package() -> None:
    """Raise PublishError if psycopg is not installed."""
    try:
        import psycopg  # noqa: F401
    except ImportError:
        raise PublishError(Message("publisher_no_package")) from None


class Destination:
    """A connection, which :meth:`connect` opens again after a failure. Only one thread at a time may use it,
    except for :meth:`abandon`."""

    def __init__(
        self, settings: PostgresqlSettings, site: str, identity: str, buses: Sequence[BusSettings]
    ) -> None:
        self._settings, self._site, self._identity, self._buses = settings, site, identity, buses
        self._connection: psycopg.Connection[Any] | None = None
        self._in_use = threading.RLock()
        self._abandoned = False
        self._socket: socket.socket | None = None
        """A second descriptor of the connection's socket, by which another thread can end it."""
        self._months: set[tuple[Table, tuple[int, int]]] = set()
        self._partitioned: set[str] = set()
        self.clock_ahead_s = 0.0
        """The seconds by which the database's clock was ahead of this machine's at connecting."""

    def connect(self) -> None:
        """Connect unless connected, and bring the tables and the names of units up to date. Raise
        PublishError or SchemaError."""
        if self._connection is not None:
            return
        require_package()
        with self._in_words():
            connection = self._open()
            with connection.transaction():
                _prepare(connection, self._settings.quoted_schema, self._site, self._identity)
                self._partitioned = _partitioned(connection, self._settings.quoted_schema)
                for table in (UNIT, *MONTHLY):
                    connection.execute(
                        f"CREATE TEMPORARY TABLE incoming_{table.name}"
                        f" (LIKE {self._settings.quoted_schema}.{table.name}) ON COMMIT DELETE ROWS".encode()
                    )
            self.clock_ahead_s = _clock_difference(connection, float(unix_now()))
            self._send_units(connection)

    def examine(self) -> float:
        """Do the same as `connect` and undo it; return the seconds by which the database's clock is ahead.
        Raise PublishError or SchemaError."""
        import psycopg

        require_package()
        with self._in_words():
            connection = self._open()
            with connection.transaction():
                _prepare(connection, self._settings.quoted_schema, self._site, self._identity)
                _add_month(connection, self._settings.quoted_schema, MONTHLY[0], _month_of(datetime.now(UTC)))
                raise psycopg.Rollback
            return _clock_difference(connection, float(unix_now()))

    def send(self, batch: Batch, published_at: UnixTime) -> None:
        """Send rows in one transaction; equal rows that exist already are not written again. Raise
        PublishError or SchemaError."""
        with self._connected() as connection, connection.transaction():
            for table, rows in batch.rows.items():
                if rows:
                    self._copy(connection, table, list(rows.values()))
            query = f"UPDATE {self._settings.quoted_schema}.site SET published_at = to_timestamp(%s)"
            connection.execute(f"{query} WHERE name = %s".encode(), (float(published_at), self._site))

    def keep_up(self, now: UnixTime) -> None:
        """Create the partitions of the next month, and remove rows older than ``keep_months``, by the earlier
        of both clocks: a clock that is ahead removes nothing. Raise PublishError."""
        schema, keep_months = self._settings.quoted_schema, self._settings.keep_months
        with self._connected() as connection:
            today = datetime.fromtimestamp(float(now), UTC)
            earlier = today + timedelta(seconds=min(0.0, _clock_difference(connection, float(now))))
            with connection.transaction():
                for table in MONTHLY:
                    if table.name in self._partitioned:
                        _add_month(connection, schema, table, _month_after(_month_of(today), 1))
                if keep_months is not None:
                    _remove_old(connection, schema, self._site, earlier, keep_months)
            self._months.clear()

    def hashes(self, after: int, limit: int) -> list[tuple[int, list[str]]]:
        """Return events of the site after a number, in order: the number of each, and every hash with which
        it was ever published. Raise PublishError or SchemaError."""
        with self._connected() as connection:
            query = (
                f"SELECT id, array_agg(hash) FROM {self._settings.quoted_schema}.event"
                " WHERE site = %s AND id > %s GROUP BY id ORDER BY id LIMIT %s"
            )
            return connection.execute(query.encode(), (self._site, after, limit)).fetchall()

    def extents(self, after: UnixTime) -> list[tuple[int, datetime | None, datetime | None]]:
        """Return the number of events and of readings that the site published from a time on, each with the
        first and the last instant (None if there is none). Raise PublishError or SchemaError."""
        with self._connected() as connection:
            found = []
            for table in (EVENT, READING):
                query = (
                    f"SELECT count(*), min(at), max(at) FROM {self._settings.quoted_schema}.{table.name}"
                    " WHERE site = %s AND at > to_timestamp(%s)"
                )
                found += connection.execute(query.encode(), (self._site, float(after))).fetchall()
            return found

    def abandon(self) -> None:
        """End the connection. If another thread uses it, that one gets an error and closes it: libpq would go
        on in freed memory if it were closed here."""
        if self._in_use.acquire(blocking=False):
            try:
                self._close()
            finally:
                self._in_use.release()
            return
        self._abandoned = True
        if self._socket is not None:
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _close(self) -> None:
        connection, self._connection = self._connection, None
        self._abandoned = False
        self._months.clear()
        if connection is not None:
            connection.close()
        if self._socket is not None:
            self._socket.close()

    def _open(self) -> psycopg.Connection[Any]:
        import psycopg

        file = self._settings.password_file
        try:
            password = None if file is None else read_secret_text(file)
        except SecretFileError as error:
            raise PublishError(error.message) from error
        connection = self._connection = psycopg.connect(
            self._settings.url,
            autocommit=True,
            application_name="lineside",
            connect_timeout=CONNECT_S,
            keepalives_idle=SILENCE_S // 2,
            keepalives_interval=SILENCE_S // 6,
            tcp_user_timeout=SILENCE_S * 1000,
            options=OPTIONS,
            password=password,
        )
        self._socket = socket.socket(fileno=os.dup(connection.fileno()))
        return connection

    def _copy(self, connection: psycopg.Connection[Any], table: Table, rows: Sequence[Row]) -> None:
        schema, columns = self._settings.quoted_schema, ("site", *table.columns)
        if table.name in self._partitioned:
            for month in {(table, _month_of(row[0])) for row in rows} - self._months:
                _add_month(connection, schema, *month)
                self._months.add(month)
        names, key = ", ".join(columns), ("site", *table.key)
        with connection.cursor() as cursor:
            with cursor.copy(f"COPY incoming_{table.name} ({names}) FROM STDIN".encode()) as copy:
                for row in rows:
                    copy.write_row((self._site, *row))
            cursor.execute(
                f"INSERT INTO {schema}.{table.name} AS present ({names})"
                f" SELECT {names} FROM incoming_{table.name}"
                f" ON CONFLICT ({', '.join(key)}) {_on_conflict(table, key)}".encode()
            )
            cursor.execute(f"TRUNCATE incoming_{table.name}".encode())

    def _send_units(self, connection: psycopg.Connection[Any]) -> None:
        """Send a new row for each unit whose names have changed since its newest row."""
        names = ", ".join(UNIT.columns)
        query = f"SELECT {names} FROM {self._settings.quoted_schema}.unit_now WHERE site = %s"
        newest = {row[1:3]: row for row in connection.execute(query.encode(), (self._site,))}
        now = datetime.now(UTC)
        rows = []
        for bus in self._buses:
            for unit in bus.unit:
                known = newest.get((bus.name, unit.id))
                row = unit_row(bus, unit, now if known else BEGINNING)
                if known is None or known[1:] != row[1:]:
                    rows.append(row)
        with connection.transaction():
            self._copy(connection, UNIT, rows)

    @contextmanager
    def _connected(self) -> Iterator[psycopg.Connection[Any]]:
        self.connect()
        with self._in_words():
            assert self._connection is not None
            yield self._connection

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        """Turn errors of psycopg into words, and close the connection: the next attempt opens another."""
        import psycopg

        with self._in_use:
            failed = True
            try:
                yield
                failed = self._abandoned
            except psycopg.Error as error:
                raise PublishError(self._words(error)) from error
            finally:
                if failed:
                    self._close()

    def _words(self, error: psycopg.Error) -> Message:
        from psycopg import errors

        lines = str(error).strip().splitlines()
        reason = lines[0] if lines else type(error).__name__
        place, schema = self._settings.place, self._settings.db_schema
        if isinstance(error, errors.InsufficientPrivilege):
            return Message.of("publisher_no_right", place=place, schema=schema, reason=reason)
        if isinstance(error, errors.DiskFull):
            return Message.of("publisher_disk_full", place=place, reason=reason)
        if isinstance(error, errors.OperationalError) and error.sqlstate is None:
            return Message.of("publisher_unreachable", place=place, reason=reason)
        return Message.of("publisher_failed", place=place, reason=reason)


def _on_conflict(table: Table, key: Sequence[str]) -> str:
    if table.is_final:
        return "DO NOTHING"
    others = [name for name in table.columns if name not in key]
    new = ", ".join(f"{name} = excluded.{name}" for name in others)
    present, excluded = (", ".join(f"{row}.{name}" for name in others) for row in ("present", "excluded"))
    return f"DO UPDATE SET {new} WHERE ({present}) IS DISTINCT FROM ({excluded})"


# --- tables ---


def _table(schema: str, table: Table) -> str:
    columns = ", ".join(f"{name} {_TYPES.get(name, 'text')}" for name in table.columns)
    key = ", ".join(("site", *table.key))
    parts = f" PARTITION BY RANGE ({table.key[0]})" if table in MONTHLY else ""
    return f"CREATE TABLE {schema}.{table.name} (site text NOT NULL, {columns}, PRIMARY KEY ({key})){parts}"


def _statements(schema: str) -> Iterator[str]:
    """Yield the statements that create the tables."""
    yield f"CREATE TABLE {schema}.{MARK} (version integer NOT NULL)"
    yield f"INSERT INTO {schema}.{MARK} VALUES ({VERSION})"
    yield f"CREATE TABLE {schema}.site (name text PRIMARY KEY, id text NOT NULL, published_at timestamptz)"
    yield from (_table(schema, table) for table in (UNIT, *MONTHLY))
    yield f"CREATE INDEX ON {schema}.{EVENT.name} (site, id)"
    yield (
        f"CREATE VIEW {schema}.unit_now AS SELECT DISTINCT ON (site, bus, unit) *"
        f" FROM {schema}.{UNIT.name} ORDER BY site, bus, unit, valid_from DESC"
    )


def _prepare(connection: psycopg.Connection[Any], schema: str, site: str, identity: str) -> None:
    """Create the schema and its tables unless they exist, in the present transaction; ``schema`` is quoted.
    Raise SchemaError for tables of another program or of a newer version, and for a site of this name that
    another server publishes."""
    name = schema.strip('"')
    # Two sites may come to an empty database at the same time.
    connection.execute("SELECT pg_advisory_xact_lock(hashtext(%s))", (f"lineside {schema}",))
    if not _one(connection, "SELECT 1 FROM pg_namespace WHERE nspname = %s", name):
        _run(connection, f"CREATE SCHEMA {schema}")
    present = _one(
        connection,
        "SELECT array_agg(relname::text) FROM pg_class WHERE relnamespace = %s::regnamespace",
        schema,
    )
    names = set(present[0] or ()) if present else set()
    if MARK not in names and (foreign := sorted(names & set(_NAMES))):
        raise SchemaError(Message.of("publisher_foreign_tables", schema=name, tables=", ".join(foreign)))
    if MARK not in names:
        for statement in _statements(schema):
            _run(connection, statement)
    elif (found := _one(connection, f"SELECT version FROM {schema}.{MARK}")) and found[0] > VERSION:
        raise SchemaError(Message.of("publisher_newer_schema", schema=name, found=found[0], known=VERSION))
    _claim(connection, schema, site, identity)


def _claim(connection: psycopg.Connection[Any], schema: str, site: str, identity: str) -> None:
    """Enter the site in the database. Raise SchemaError if another site has its name."""
    _run(
        connection,
        f"INSERT INTO {schema}.site (name, id) VALUES (%s, %s) ON CONFLICT DO NOTHING",
        site,
        identity,
    )
    found = _one(connection, f"SELECT id FROM {schema}.site WHERE name = %s", site)
    if found is None or found[0] != identity:
        named = schema.strip('"')
        raise SchemaError(Message.of("publisher_other_site", schema=named, site=site))


def _clock_difference(connection: psycopg.Connection[Any], now: float) -> float:
    """Return the seconds by which the database's clock is ahead of ``now``, Unix time."""
    found = _one(connection, "SELECT extract(epoch FROM clock_timestamp())::float8")
    assert found is not None
    return float(found[0]) - now


# --- partitions ---


def _month_of(at: datetime) -> tuple[int, int]:
    """Return the year and the month of a row, by UTC."""
    at = at.astimezone(UTC)
    return at.year, at.month


def _partitioned(connection: psycopg.Connection[Any], schema: str) -> set[str]:
    """Return the names of the partitioned tables; a plant may have replaced one by its own table."""
    query = "SELECT relname::text FROM pg_class WHERE relnamespace = %s::regnamespace AND relkind = 'p'"
    return {name for [name] in connection.execute(query, (schema,))}


def _add_month(
    connection: psycopg.Connection[Any], schema: str, table: Table, month: tuple[int, int]
) -> None:
    """Create the partition of a month unless it exists."""
    name = f"{schema}.{table.name}_y{month[0]:04d}m{month[1]:02d}"
    if (found := _one(connection, "SELECT to_regclass(%s)", name)) and found[0]:
        return
    connection.execute("SELECT pg_advisory_xact_lock(hashtext(%s))", (f"lineside {schema}",))
    bounds = f"FROM ('{_bound(month)}') TO ('{_bound(_month_after(month, 1))}')"
    _run(
        connection,
        f"CREATE TABLE IF NOT EXISTS {name} PARTITION OF {schema}.{table.name} FOR VALUES {bounds}",
    )


def _month_after(month: tuple[int, int], by: int) -> tuple[int, int]:
    """Return the month ``by`` months later."""
    years, number = divmod(12 * month[0] + month[1] - 1 + by, 12)
    return years, number + 1


def _bound(month: tuple[int, int]) -> str:
    return f"{month[0]:04d}-{month[1]:02d}-01 00:00:00+00"


def _remove_old(
    connection: psycopg.Connection[Any], schema: str, site: str, now: datetime, keep_months: int
) -> None:
    """Remove the rows of a site that are older than ``keep_months`` complete months before the current one.
    The partition of a month is dropped if no other site has rows in it."""
    first = _month_after(_month_of(now), -keep_months)
    for table in MONTHLY:
        query = "SELECT inhrelid::regclass::text FROM pg_inherits WHERE inhparent = %s::regclass"
        parts = connection.execute(query, (f"{schema}.{table.name}",)).fetchall()
        for [name] in parts:
            month = _MONTH.search(name)
            if month is None or (int(month[1]), int(month[2])) >= first:
                continue
            if _one(connection, f"SELECT 1 FROM {name} WHERE site <> %s LIMIT 1", site):
                _run(connection, f"DELETE FROM {name} WHERE site = %s", site)
            else:
                _run(connection, f"DROP TABLE {name}")


def _run(connection: psycopg.Connection[Any], statement: str, *values: object) -> None:
    connection.execute(statement.encode(), values or None)


def _one(connection: psycopg.Connection[Any], query: str, *values: object) -> tuple[Any, ...] | None:
    return connection.execute(query.encode(), values or None).fetchone()


# --- the events as a witness of the audit log ---


CHUNK = 5000


@dataclass
class Comparison:
    """The result of a comparison. ``same``: events with the same hash in both; ``replaced``: those of them
    for which the database also has another hash; ``unpublished``: events that only the log has, from the
    first event in the database on."""

    same: int = 0
    replaced: int = 0
    unpublished: int = 0


def compare(connection: StoreConnection, destination: Destination) -> Comparison:
    """Compare every event in the database with the log. Raise StoreError with the first event that the log
    lacks or has with another content."""
    found, after, first = Comparison(), 0, 0
    archived = max((cut.last for cut in cuts_of(connection)), default=0)
    while published := destination.hashes(after, CHUNK):
        numbers = published[0][0], published[-1][0]
        query = "SELECT id, hash FROM events WHERE id BETWEEN ? AND ?"
        stored = dict(map(tuple, connection.execute(query, numbers)))
        for number, hashes in published:
            if number in stored and stored[number] in hashes:
                found.same += 1
                found.replaced += len(hashes) > 1
            elif number in stored:
                raise StoreError(Message.of("audit_witness_differs", entry=number))
            elif number > archived:
                raise StoreError(Message.of("audit_witness_lacks", entry=number))
        first, after = first or numbers[0], numbers[1]
    [count] = connection.execute("SELECT count(*) FROM events WHERE id >= ?", (first,)).fetchone()
    found.unpublished = count - found.same
    return found
