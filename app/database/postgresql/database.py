"""A store that is a schema of a PostgreSQL database, which other servers may have, too."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from select import POLLIN, poll
from typing import TypeVar

import psycopg

from app.database.availability import Availability
from app.database.database import COSTLY_S, Database, Listener, Work
from app.database.migration import MIGRATIONS
from app.database.postgresql.connection import PostgresqlConnection, connect, interrupt_all, name_of
from app.database.postgresql.listening import Listening
from app.database.postgresql.migrating import bring_up_to_date, is_unfinished
from app.database.postgresql.rows import NamedRow
from app.database.postgresql.words import in_words
from app.database.settings import StoreSettings
from app.database.sqlite.connection import Synchronous
from app.database.unfinished import refuse_unfinished
from app.errors import StoreUnavailableError
from bus.messages import Message

T = TypeVar("T")
Driver = psycopg.Connection[NamedRow]
WRITING = {"idle_in_transaction_session_timeout": 5000, "lock_timeout": 10_000}
"""ms that a transaction may wait for its server, while those of other servers wait for it; and for them."""
BRIEF = {"idle_in_transaction_session_timeout": 1000, "lock_timeout": 1000}
"""The same for what is renewed each second. No statement_timeout: it would end the wait of a commit for the
standby, and the commit would count."""
BRIEF_CONNECTION = {"connect_timeout": 2, "tcp_user_timeout": 2000}
"""How soon its connection is taken for lost, and another tried."""


class PostgresqlDatabase(Database):
    """Each thread has its connection, which is opened when it is needed and again where it was lost."""

    def __init__(
        self,
        store: StoreSettings,
        schema: str,
        migrations: Path = MIGRATIONS,
        synchronous: Synchronous = "FULL",
        availability: Availability | None = None,
    ) -> None:
        """``synchronous`` NORMAL: a commit does not wait for the disk, nor for a standby. A crash of the
        database server loses the last of them, in order, and damages nothing."""
        self._store = store
        self._schema = schema
        self._of_writer: dict[str, str | int] = dict(WRITING)
        if synchronous == "NORMAL":
            self._of_writer["synchronous_commit"] = "off"
        self.file = None
        self.availability = availability
        name = name_of(store, schema)
        with in_words(name):
            driver = connect(store, schema, **self._of_writer)
            try:
                refuse_unfinished(name, has_ledger=is_unfinished(driver, schema))
                self.migrated = bring_up_to_date(driver, schema, migrations, name)
            except BaseException:
                driver.close()
                raise
        super().__init__(name, schema)
        self._writing = driver
        self._writing_briefly: Driver | None = None
        self._brief = ThreadPoolExecutor(1, thread_name_prefix=f"{schema}-brief")
        self._local = threading.local()
        self._opened: list[Driver] = []
        self._listening = Listening(self._connect, schema)

    def write_now(self, work: Work[T]) -> T:
        with in_words(self.name):
            if not is_usable(self._writing):
                self._writing.close()
                self._writing = self._connect(**self._of_writer)
            return transact(self._writing, work, self.name)

    def write_briefly_now(self, work: Work[T]) -> T:
        with in_words(self.name):
            driver = self._writing_briefly
            if driver is None or not is_usable(driver):
                if driver is not None:
                    driver.close()
                driver = connect(self._store, self._schema, BRIEF_CONNECTION, **BRIEF)
                self._writing_briefly = driver
            return transact(driver, work, self.name)

    def read_now(self, work: Work[T]) -> T:
        with in_words(self.name):
            return work(self._reader("connection"))

    def listen(self, channel: str, callback: Listener) -> None:
        self._listening.add(channel, callback)

    def interrupt(self) -> None:
        interrupt_all()

    def give_back(self, pages: int) -> None:
        """PostgreSQL vacuums on its own."""

    def _disconnect(self) -> None:
        self._listening.close()
        for driver in (*self._opened, self._writing, self._writing_briefly):
            if driver is not None:
                driver.close()

    def _read_within(self, work: Work[T]) -> T:
        with in_words(self.name):
            return work(self._reader("costly", statement_timeout=round(1000 * COSTLY_S)))

    def _reader(self, kind: str, **options: int) -> PostgresqlConnection:
        """The connection of this thread, which cannot write."""
        driver: Driver | None = getattr(self._local, kind, None)
        if driver is None or not is_usable(driver):
            if driver is not None:
                # Before the next one, which may fail.
                setattr(self._local, kind, None)
                self._opened.remove(driver)
                driver.close()
            driver = self._connect(default_transaction_read_only="on", **options)
            setattr(self._local, kind, driver)
            self._opened.append(driver)
        return PostgresqlConnection(driver)

    def _connect(self, **options: str | int) -> Driver:
        return connect(self._store, self._schema, **options)


def is_usable(driver: Driver) -> bool:
    """Whether a connection that was idle is not known to be lost. Nothing is sent to the server."""
    if driver.closed:
        return False
    # The server sends nothing without a request but that it ends the connection. Not `select`: that takes no
    # descriptor past 1023.
    waiting = poll()
    waiting.register(driver.fileno(), POLLIN)
    return not waiting.poll(0)


def transact(driver: Driver, work: Work[T], name: str) -> T:
    """``work`` inside one transaction: all of it, or none when it raises."""
    driver.execute("BEGIN")
    try:
        result = work(PostgresqlConnection(driver))
        # A transaction in which a statement failed is rolled back, which is no error to PostgreSQL.
        if driver.execute("COMMIT").statusmessage != "COMMIT":
            raise StoreUnavailableError(
                Message.of("store_failed", path=name, reason=Message("store_rolled_back"))
            )
    except BaseException:
        if not driver.closed and driver.info.transaction_status:
            driver.execute("ROLLBACK")
        raise
    return result
