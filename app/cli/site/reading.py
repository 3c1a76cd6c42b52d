"""The main store of a site for a command that only reads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from app.cli.serving.serve import check_store
from app.database import StoreConnection
from app.database.connection import examining
from app.database.migration import require_version
from app.database.presence import presence_of
from app.errors import StoreError
from app.settings import Settings
from bus.messages import Message


def has_store(settings: Settings) -> bool:
    """Whether the site has a main store. Raises StoreError."""
    return presence_of(settings.server.store) != "missing"


@contextmanager
def reading_site(settings: Settings) -> Iterator[StoreConnection]:
    """Read the main store as it is, also on a read-only disk: nothing is made or changed. Raises StoreError,
    also for one of another version."""
    check_store(settings)
    if not has_store(settings):
        raise StoreError(Message.of("store_missing", path=str(settings.server.store)))
    with examining(settings.server.store) as connection:
        require_version(connection, settings.server.store)
        yield connection
