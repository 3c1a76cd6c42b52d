"""The main store and event log of a site for a command, whether the dashboard runs or not."""

from __future__ import annotations

import asyncio
import getpass
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from app.cli.command import become_owner_of
from app.cli.starting import check_store
from app.core.database import Database, StoreConnection
from app.core.database.connection import examining
from app.core.database.files import in_words, make_private
from app.core.database.migration import presence_of, put_aside, require_version
from app.core.web.access import Person, Role
from app.errors import StoreError
from app.line.history.service import FILE as HISTORY
from app.people.audit.entry import EventKind
from app.people.audit.keys import find_key_file, open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from app.settings import Settings
from bus.messages import Message


def console() -> Person:
    """Return the user of this machine as the caller of an act: a user who can write the store has every
    role."""
    try:
        name = getpass.getuser()
    except (KeyError, OSError):
        name = ""
    return Person(name, Role.ADMIN, "console", address=Message("command_line"))


def record(events: EventLog, kind: EventKind, what: Message, message: str | Message = "") -> None:
    """Record an event about an act of the user of this machine."""
    by = console()
    who = by.name or by.address
    asyncio.run(events.record(kind=kind, what=what, who=who, origin=by.address, message=message))


def open_log(database: Database, key_files: Sequence[Path]) -> EventLog:
    """Return the event log of a store with its keys. Raise KeyFileError."""
    return EventLog(database, keys=open_keys(key_files, database.path, database.read_now(heads_of)))


@contextmanager
def site_log(settings: Settings) -> Iterator[tuple[Database, EventLog]]:
    """Open the main store of a site and its event log. Raise StoreError or KeyFileError."""
    become_owner_of(settings.server.data)
    check_store(settings)
    make_private(settings.server.data)
    with closing(Database(settings.server.store, checkpoints=False)) as database:
        yield database, open_log(database, settings.key_files)


def has_store(settings: Settings) -> bool:
    """Return whether the site has a main store. Raise StoreError."""
    return presence_of(settings.server.store) != "missing"


@contextmanager
def reading_site(settings: Settings) -> Iterator[StoreConnection]:
    """Read the main store as it is, also on a read-only disk: nothing is created or changed. Raise
    StoreError, also for a store of another version."""
    check_store(settings)
    if not has_store(settings):
        raise StoreError(Message.of("store_missing", path=str(settings.server.store)))
    with examining(settings.server.store) as connection:
        require_version(connection, settings.server.store)
        yield connection


def open_history(settings: Settings, opened: ExitStack) -> StoreConnection | None:
    """Open the history of a site until ``opened`` ends; return None if the site has none."""
    file = settings.server.data / HISTORY
    return opened.enter_context(examining(file)) if file.exists() else None


def begin_new_site(settings: Settings) -> None:
    """Make a new store and a new key, with an entry in the new audit log; keep the rest of the former site
    under other names. Raise StoreError, also if the former store can be used or the configured anchor belongs
    to the former site."""
    check_store(settings, new=True)
    if settings.audit.anchor is not None and settings.audit.anchor.exists():
        # The anchor may be on write-once media, and would contradict the new log at each start.
        raise StoreError(Message.of("anchor_of_former_site", path=str(settings.audit.anchor)))
    become_owner_of(settings.server.data)
    store, key = settings.server.store, find_key_file(settings.key_files)
    presence = presence_of(store)
    with in_words(store):
        if presence == "damaged":
            put_aside(store)
        if key is not None:
            # Two stores cannot share a key file: it states the end of its store's log.
            stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
            key.rename(key.with_name(f"{key.name}.before-{stamp}"))
    with closing(Database(store)) as database:
        what = Message.of("event_site_begun", store=Message(f"store_was_{presence}"))
        record(open_log(database, settings.key_files), "server", what)
