"""A history whose database can be away: a writer with its spool, in a folder or in PostgreSQL."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import pytest

from app.database import SqliteDatabase, StoreConnection
from app.database.settings import IN_FILES, StoreSettings
from app.errors import StoreUnavailableError
from app.history.intake.share import COMPLETE, StoreShare
from app.history.intake.tail import Tail
from app.history.intake.writer import Writer
from app.history.series.runs import HOUR, Run, merge, micros
from app.history.settings import HistorySettings
from app.history.spool.outage import Outage
from app.history.spool.spool import Spool
from app.history.store import tables
from bus.messages import Message
from tests.app.history_line import BUS

T = TypeVar("T")
MAX_SPOOLED = 1_000_000


class AwayDatabase(SqliteDatabase):
    """As a database server seems that is away while a file exists; while another one does, transactions are
    committed and the connection is lost before their result."""

    away: Path
    mute: Path

    def write_now(self, work: Callable[[StoreConnection], T]) -> T:
        self._reach()
        result = super().write_now(work)
        if self.mute.exists():
            raise StoreUnavailableError(Message("store_disk_failed"))
        return result

    def read_now(self, work: Callable[[StoreConnection], T]) -> T:
        self._reach()
        return super().read_now(work)

    def _reach(self) -> None:
        if self.away.exists():
            raise StoreUnavailableError(Message("store_disk_failed"))


def opened_away(folder: Path) -> Callable[..., AwayDatabase]:
    """In place of `open_database`."""

    def open_database(
        _settings: StoreSettings, path: Path, migrations: Path, _synchronous: str
    ) -> AwayDatabase:
        away = folder / "away"
        if away.exists():
            raise StoreUnavailableError(Message("store_disk_failed"))
        database = AwayDatabase(path, migrations, "NORMAL")
        database.file, database.away, database.mute = None, away, folder / "mute"
        return database

    return open_database


@contextmanager
def quickly(patch: pytest.MonkeyPatch, folder: Path | None = None) -> Iterator[None]:
    """Commits and attempts to connect follow each other fast; with a folder, the database is a file in it."""
    with patch.context() as patched:
        patched.setattr("app.history.intake.writer.COMMIT_EVERY_S", 0.01)
        patched.setattr("app.history.intake.writer.RECONNECT_S", 0.02)
        if folder is not None:
            patched.setattr("app.history.intake.opening.open_database", opened_away(folder))
        yield


def writer_of(
    folder: Path,
    on_event: Callable[[Message], None] = lambda _: None,
    *,
    store: StoreSettings = IN_FILES,
    share: StoreShare = COMPLETE,
    most: int = MAX_SPOOLED,
) -> Writer:
    """A writer that spools, with its thread."""
    outage = Outage(Spool(folder / "spool", most), on_event)
    path = folder / "history.db"
    writer = Writer(
        path,
        HistorySettings(),
        lambda _kind, what: on_event(what),
        store=store,
        share=share,
        outage=outage,
    )
    writer.start()
    return writer


def stored(connection: StoreConnection, tail: Tail, start: float, end: float) -> list[Run]:
    """All runs of unit 1 over a span, each once."""
    key = tables.find_unit(connection, BUS.name, 1)
    if key is None:
        return []
    span = micros(start), micros(end)
    found = merge(tables.raw_between(connection, key, span[0] - HOUR, span[1]), tail.runs(key, *span))
    return [run for run in found if span[0] <= run.at < span[1]]


def stored_in(writer: Writer, start: float, end: float) -> list[Run]:
    """The same of a writer that runs."""
    return writer.database.read_now(lambda connection: stored(connection, writer.tail, start, end))
