"""The tables of the plant's database: how they are made, which of them are refused, and their partitions."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from app.errors import StoreError
from app.system.postgresql.rows import ALARM, BIT_COLUMNS, EVENT, MINUTE_TABLE, READING, UNIT, Table
from bus.messages import Message

if TYPE_CHECKING:
    import psycopg

MARK = "lineside_version"
"""The table by which a schema is known as one of Lineside."""
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
"""Of each column that is no text."""
_MONTH = re.compile(r"_y(\d{4})m(\d{2})$")


class SchemaError(StoreError):
    """The plant's database cannot take what is published; the message says what to do."""


def _table(schema: str, table: Table) -> str:
    columns = ", ".join(f"{name} {_TYPES.get(name, 'text')}" for name in table.columns)
    key = ", ".join(("site", *table.key))
    parts = f" PARTITION BY RANGE ({table.key[0]})" if table in MONTHLY else ""
    return f"CREATE TABLE {schema}.{table.name} (site text NOT NULL, {columns}, PRIMARY KEY ({key})){parts}"


def _first_step(schema: str) -> Iterable[str]:
    """Make the tables of version 1."""
    yield f"CREATE TABLE {schema}.{MARK} (version integer NOT NULL)"
    yield f"INSERT INTO {schema}.{MARK} VALUES (0)"
    yield f"CREATE TABLE {schema}.site (name text PRIMARY KEY, id text NOT NULL, published_at timestamptz)"
    yield from (_table(schema, table) for table in (UNIT, *MONTHLY))
    yield f"CREATE INDEX ON {schema}.{EVENT.name} (site, id)"
    yield (
        f"CREATE VIEW {schema}.unit_now AS SELECT DISTINCT ON (site, bus, unit) *"
        f" FROM {schema}.{UNIT.name} ORDER BY site, bus, unit, valid_from DESC"
    )


STEPS = (_first_step,)
"""What makes each version of the tables out of the one before."""
VERSION = len(STEPS)
NAMES = ("site", UNIT.name, *(table.name for table in MONTHLY), "unit_now")


def prepare(connection: psycopg.Connection[Any], schema: str, site: str, identity: str) -> None:
    """Make what is missing, within the present transaction; ``schema``: quoted. Raises SchemaError for tables
    of another program or of a newer version, and where another server publishes a site of this name."""
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
    if MARK not in names and (foreign := sorted(names & set(NAMES))):
        raise SchemaError(Message.of("publisher_foreign_tables", schema=name, tables=", ".join(foreign)))
    version = _version(connection, schema) if MARK in names else 0
    if version > VERSION:
        raise SchemaError(Message.of("publisher_newer_schema", schema=name, found=version, known=VERSION))
    for step in STEPS[version:]:
        for statement in step(schema):
            _run(connection, statement)
    if version < VERSION:
        _run(connection, f"UPDATE {schema}.{MARK} SET version = {VERSION}")
    _claim(connection, schema, site, identity)


def _version(connection: psycopg.Connection[Any], schema: str) -> int:
    found = _one(connection, f"SELECT version FROM {schema}.{MARK}")
    return int(found[0]) if found else 0


def _claim(connection: psycopg.Connection[Any], schema: str, site: str, identity: str) -> None:
    """Note the site in the database, or find that it is the one that is noted."""
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


def clock_difference(connection: psycopg.Connection[Any], now: float) -> float:
    """Return by how many seconds the clock of the database is ahead of a time of this machine, Unix time."""
    found = _one(connection, "SELECT extract(epoch FROM clock_timestamp())::float8")
    assert found is not None
    return float(found[0]) - now


# --- partitions -------------------------------------------------------------------------------------------


def month_of(at: datetime) -> tuple[int, int]:
    """Return the year and the month of a row, by UTC."""
    at = at.astimezone(UTC)
    return at.year, at.month


def partitioned(connection: psycopg.Connection[Any], schema: str) -> set[str]:
    """Return the names of the tables that have partitions. A plant may have put others in their places."""
    query = "SELECT relname::text FROM pg_class WHERE relnamespace = %s::regnamespace AND relkind = 'p'"
    return {name for [name] in connection.execute(query, (schema,))}


def add_month(connection: psycopg.Connection[Any], schema: str, table: Table, month: tuple[int, int]) -> None:
    """Make the partition of a month where there is none."""
    name = f"{schema}.{table.name}_y{month[0]:04d}m{month[1]:02d}"
    if (found := _one(connection, "SELECT to_regclass(%s)", name)) and found[0]:
        return
    connection.execute("SELECT pg_advisory_xact_lock(hashtext(%s))", (f"lineside {schema}",))
    bounds = f"FROM ('{_bound(month)}') TO ('{_bound(later(month, 1))}')"
    _run(
        connection,
        f"CREATE TABLE IF NOT EXISTS {name} PARTITION OF {schema}.{table.name} FOR VALUES {bounds}",
    )


def later(month: tuple[int, int], by: int) -> tuple[int, int]:
    """Return the month that is so many months later; earlier where ``by`` is negative."""
    years, number = divmod(12 * month[0] + month[1] - 1 + by, 12)
    return years, number + 1


def _bound(month: tuple[int, int]) -> str:
    return f"{month[0]:04d}-{month[1]:02d}-01 00:00:00+00"


def remove_old(
    connection: psycopg.Connection[Any], schema: str, site: str, now: datetime, keep_months: int
) -> None:
    """Remove the rows of a site that are older than so many complete months before the current one. A month
    without rows of another site goes at once, as a table."""
    first = later(month_of(now), -keep_months)
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
