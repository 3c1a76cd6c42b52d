"""Opens the store for the writer: at once, or in a separate thread where a database can be away."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from app.database import Database
from app.database.opening import open_database
from app.database.settings import StoreSettings
from app.database.sqlite.connection import Synchronous
from app.history.intake.database_outage import DatabaseOutage
from app.history.intake.recorder import Recorder
from app.history.intake.share import StoreShare
from app.history.intake.tail import Tail
from app.history.intake.upkeep import DiskReserve, Upkeep
from app.history.series.runs import micros
from app.history.settings import HistorySettings
from app.history.store import tables
from app.history.store.inspection import FoundDamage
from bus.instants import unix_now

MIGRATIONS = Path(__file__).parents[1] / "migrations"


@dataclass(slots=True)
class OpenStore:
    """The store, and what writes into it."""

    database: Database
    recorder: Recorder
    upkeep: Upkeep


@dataclass(slots=True)
class Opening:
    """Opens the store as often as needed."""

    path: Path
    settings: StoreSettings
    kept: HistorySettings
    reserve: DiskReserve
    share: StoreShare
    outage: DatabaseOutage | None
    tail: Tail
    on_damage: FoundDamage
    pending: Future[OpenStore] | None = None

    def open(self, before: OpenStore | None) -> OpenStore:
        """The store, with its journal in the tail. A database that was away is the same as before. Raises
        StoreError."""
        is_same = before is not None and self.outage is not None
        database = before.database if before is not None and is_same else self._connect()
        recorder = Recorder(database, self.tail, self.on_damage, self.share)
        try:
            # The first row shows whether the store can be written.
            database.write_now(lambda c: tables.correct_raw_from(c, micros(unix_now())))
            recorder.replay()
            if self.outage is not None:
                self.outage.attach(database, self.on_damage)
        except BaseException:
            if not is_same:
                database.close()
            raise
        upkeep = Upkeep(database, self.kept, self.reserve, self.on_damage, self.share)
        return OpenStore(database, recorder, upkeep)

    def open_aside(self, before: OpenStore | None) -> OpenStore | None:
        """The same in a thread: None until it has ended. Raises what it raised."""
        if self.pending is None:
            self.pending = Future()
            settle = (self.pending, lambda: self.open(before))
            threading.Thread(target=_settle, args=settle, name="history-reconnect", daemon=True).start()
        if not self.pending.done():
            return None
        pending, self.pending = self.pending, None
        return pending.result()

    def _connect(self) -> Database:
        # Half a second of readings is in memory at any time: a database server need not wait for its disk.
        synchronous: Synchronous = "FULL" if self.outage is None else "NORMAL"
        return open_database(self.settings, self.path, MIGRATIONS, synchronous)


def _settle(pending: Future[OpenStore], work: Callable[[], OpenStore]) -> None:
    try:
        pending.set_result(work())
    except BaseException as error:
        pending.set_exception(error)
