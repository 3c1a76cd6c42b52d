"""A store of SQLite that can be away, hang, or lose the confirmation of a commit, as one over a network."""

from __future__ import annotations

import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from app.audit.local_log.file import MAX_BYTES, LocalFile
from app.audit.local_log.local_log import LocalLog
from app.audit.log import EventLog
from app.audit.proof.keyring import KEY_BYTES, KeyRing
from app.audit.proof.keys import Keys
from app.database import SqliteDatabase, StoreConnection
from app.database.availability import Availability
from app.database.sqlite.reserve import Reserve
from app.errors import StoreUnavailableError
from bus.messages import Message
from tests.app.complete_app import House, complete_app

T = TypeVar("T")
GONE = StoreUnavailableError(Message("store_no_response"))
KEYS = Keys(KeyRing((b"k" * KEY_BYTES,)))


class AwayDatabase(SqliteDatabase):
    """``is_away``: nothing gets through; ``loses_commit``: the next transaction is stored, without a
    confirmation; ``responds`` and ``writes``: nothing ends before they are set again."""

    def __init__(self, path: Path, reserve: Reserve | None = None) -> None:
        super().__init__(path, reserve=reserve)
        self.availability = Availability()
        self.is_away = False
        self.loses_commit = False
        self.responds = threading.Event()
        self.responds.set()
        self.writes = threading.Event()
        self.writes.set()

    def write_now(self, work: Callable[[StoreConnection], T]) -> T:
        self._get_through()
        self.writes.wait()
        result = super().write_now(work)
        if self.loses_commit:
            self.loses_commit, self.is_away = False, True
            raise GONE
        return result

    def read_now(self, work: Callable[[StoreConnection], T]) -> T:
        self._get_through()
        return super().read_now(work)

    def _get_through(self) -> None:
        self.responds.wait()
        if self.is_away:
            raise GONE

    def leave(self) -> None:
        """Be away from now on, as the server has noticed."""
        self.is_away = True
        assert self.availability is not None
        self.availability.lost(GONE.message)

    async def come_back(self) -> None:
        """Respond again, and let the server notice."""
        self.is_away = False
        assert self.availability is not None
        await self.availability._come_back()


def local_log(
    database: AwayDatabase, folder: Path, keys: Keys = KEYS, max_bytes: int = MAX_BYTES
) -> LocalLog:
    """A server's local log."""
    assert database.availability is not None
    return LocalLog(database, database.availability, LocalFile(folder, max_bytes=max_bytes), keys)


def event_log(database: AwayDatabase, folder: Path, **options: Any) -> EventLog:
    """The audit log of a server whose database may be away."""
    local = local_log(database, folder, **options)
    return EventLog(database, keys=options.get("keys", KEYS), local=local)


@asynccontextmanager
async def away_house(folder: Path, **options: Any) -> AsyncIterator[tuple[House, AwayDatabase]]:
    """The complete app over such a store, which is away when a test makes it."""
    opened: list[AwayDatabase] = []

    def open_away(
        _store: object, path: Path, *, reserve: Reserve, availability: Availability
    ) -> AwayDatabase:
        opened.append(AwayDatabase(path, reserve))
        opened[0].availability = availability
        return opened[0]

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr("app.database.feature.open_database", open_away)
        async with complete_app(folder, **options) as house:
            yield house, opened[0]
