"""The connection to the plant's database: it sends batches, and says in words why it cannot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from app.core.server.settings import SecretFileError, read_secret_text
from app.errors import StoreError
from app.system.postgresql.outbox import Batch
from app.system.postgresql.rows import EVENT, READING, UNIT, Row, Table, instant, unit_row
from app.system.postgresql.schema import (
    MONTHLY,
    SchemaError,
    add_month,
    clock_difference,
    later,
    month_of,
    partitioned,
    prepare,
    remove_old,
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
"""After which a database that does not respond is given up."""
OPTIONS = " ".join(
    f"-c {name}={value}"
    for name, value in {
        "statement_timeout": f"{STATEMENT_S}s",
        "timezone": "UTC",
        "client_min_messages": "error",
        # The cursor goes past what is committed: that must outlive a crash of the database.
        "synchronous_commit": "on",
    }.items()
)
BEGINNING = instant(0)
"""From when on a unit is called as it is the first time that it is published: its past is filled in later."""


class PublishError(StoreError):
    """The plant's database cannot be reached, or does not take rows; the message says why."""


def require_package() -> None:
    """Raises PublishError where psycopg is not installed."""
    try:
        import psycopg  # noqa: F401
    except ImportError:
        raise PublishError(Message("publisher_no_package")) from None


class Destination:
    """One connection, which :meth:`connect` opens again after a failure. Used by one thread at a time, but
    for :meth:`abandon`."""

    def __init__(
        self, settings: PostgresqlSettings, site: str, identity: str, buses: Sequence[BusSettings]
    ) -> None:
        self._settings, self._site, self._identity, self._buses = settings, site, identity, buses
        self._connection: psycopg.Connection[Any] | None = None
        self._months: set[tuple[Table, tuple[int, int]]] = set()
        self._partitioned: set[str] = set()
        self.clock_ahead_s = 0.0
        """By how much the clock of the database is ahead of that of this machine, when it was connected."""

    def connect(self) -> None:
        """Connect where there is no connection, and bring the tables and the names of units up to date.
        Raises PublishError, SchemaError."""
        if self._connection is not None:
            return
        require_package()
        with self._in_words():
            connection = self._connection = self._opened()
            with connection.transaction():
                prepare(connection, self._settings.quoted_schema, self._site, self._identity)
                self._partitioned = partitioned(connection, self._settings.quoted_schema)
                for table in (UNIT, *MONTHLY):
                    connection.execute(
                        f"CREATE TEMPORARY TABLE incoming_{table.name}"
                        f" (LIKE {self._settings.quoted_schema}.{table.name}) ON COMMIT DELETE ROWS".encode()
                    )
            self.clock_ahead_s = clock_difference(connection, float(unix_now()))
            self._send_units(connection)

    def examine(self) -> float:
        """Do what `connect` does and undo it; return by how much the clock of the database is ahead. Raises
        PublishError, SchemaError."""
        import psycopg

        require_package()
        with self._in_words():
            connection = self._connection = self._opened()
            with connection.transaction():
                prepare(connection, self._settings.quoted_schema, self._site, self._identity)
                add_month(connection, self._settings.quoted_schema, MONTHLY[0], month_of(datetime.now(UTC)))
                raise psycopg.Rollback
            return clock_difference(connection, float(unix_now()))

    def send(self, batch: Batch, published_at: UnixTime) -> None:
        """Send rows in one transaction; those that are there are not written again. Raises PublishError, and
        SchemaError."""
        self.connect()
        with self._in_words():
            connection = self._connection
            assert connection is not None
            with connection.transaction():
                for table, rows in batch.rows.items():
                    if rows:
                        self._copy(connection, table, list(rows.values()))
                said = f"UPDATE {self._settings.quoted_schema}.site SET published_at = to_timestamp(%s)"
                connection.execute(f"{said} WHERE name = %s".encode(), (float(published_at), self._site))

    def keep_up(self, now: UnixTime) -> None:
        """Make the partitions of the next month, and remove what is older than it is to be kept. What is old,
        the earlier of both clocks says: one that is ahead removes nothing. Raises PublishError."""
        self.connect()
        schema, keep_months = self._settings.quoted_schema, self._settings.keep_months
        with self._in_words():
            connection = self._connection
            assert connection is not None
            today = datetime.fromtimestamp(float(now), UTC)
            earlier = today + timedelta(seconds=min(0.0, clock_difference(connection, float(now))))
            with connection.transaction():
                for table in MONTHLY:
                    if table.name in self._partitioned:
                        add_month(connection, schema, table, later(month_of(today), 1))
                if keep_months is not None:
                    remove_old(connection, schema, self._site, earlier, keep_months)
            self._months.clear()

    def hashes(self, after: int, limit: int) -> list[tuple[int, list[str]]]:
        """Return the next events of the site behind a number: the number of each, and every hash that it was
        ever published with. Raises PublishError, SchemaError."""
        self.connect()
        with self._in_words():
            assert self._connection is not None
            query = (
                f"SELECT id, array_agg(hash) FROM {self._settings.quoted_schema}.event"
                " WHERE site = %s AND id > %s GROUP BY id ORDER BY id LIMIT %s"
            )
            return self._connection.execute(query.encode(), (self._site, after, limit)).fetchall()

    def extents(self, after: UnixTime) -> list[tuple[int, datetime | None, datetime | None]]:
        """Return what the site published of later than a time: of events and of readings how many, the first
        and the last, which are None where there are none. Raises PublishError, SchemaError."""
        self.connect()
        with self._in_words():
            assert self._connection is not None
            found = []
            for table in (EVENT, READING):
                query = (
                    f"SELECT count(*), min(at), max(at) FROM {self._settings.quoted_schema}.{table.name}"
                    " WHERE site = %s AND at > to_timestamp(%s)"
                )
                found += self._connection.execute(query.encode(), (self._site, float(after))).fetchall()
            return found

    def abandon(self) -> None:
        """End the connection, also while a thread waits for it."""
        connection, self._connection = self._connection, None
        self._months.clear()
        if connection is not None:
            connection.close()

    def _opened(self) -> psycopg.Connection[Any]:
        import psycopg

        file = self._settings.password_file
        try:
            password = None if file is None else read_secret_text(file)
        except SecretFileError as error:
            raise PublishError(error.message) from error
        return psycopg.connect(
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

    def _copy(self, connection: psycopg.Connection[Any], table: Table, rows: Sequence[Row]) -> None:
        schema, columns = self._settings.quoted_schema, ("site", *table.columns)
        if table.name in self._partitioned:
            for month in {month_of(row[0]) for row in rows} - {
                of for each, of in self._months if each is table
            }:
                add_month(connection, schema, table, month)
                self._months.add((table, month))
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
        """Send a new row of each unit whose names have changed since its newest one."""
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
    def _in_words(self) -> Iterator[None]:
        """Turn what psycopg raises into words, and end the connection: the next attempt begins a new one."""
        import psycopg

        try:
            yield
        except SchemaError:
            self.abandon()
            raise
        except psycopg.Error as error:
            self.abandon()
            raise PublishError(self._words(error)) from error

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
