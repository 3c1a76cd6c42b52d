"""Reads a store of PostgreSQL as it is: nothing is made, nothing is brought up to date."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from app.database.postgresql.connection import PostgresqlConnection, connect, name_of
from app.database.postgresql.words import in_words
from app.database.settings import StoreSettings
from app.database.unfinished import LEDGER, refuse_unfinished


def has_site(store: StoreSettings, schema: str) -> bool:
    """Whether a site lives in the database. Raises StoreError."""
    with examining(store, schema) as connection:
        found = connection.execute("SELECT to_regclass(?)", (f"{schema}.migrations",)).fetchall()
        return found[0][0] is not None


def require_finished(store: StoreSettings, schema: str) -> None:
    """Raises StoreError where the database is a copy that is not finished."""
    with examining(store, schema) as connection:
        [(ledger,)] = connection.execute("SELECT to_regclass(?)", (f"{schema}.{LEDGER}",)).fetchall()
    refuse_unfinished(name_of(store, schema), has_ledger=ledger is not None)


@contextmanager
def examining(store: StoreSettings, schema: str) -> Iterator[PostgresqlConnection]:
    """A connection that cannot write. Raises StoreError in words."""
    with (
        in_words(name_of(store, schema)),
        closing(connect(store, schema, default_transaction_read_only="on")) as driver,
    ):
        yield PostgresqlConnection(driver)
