"""The store of users and tokens from the command line, whether the dashboard runs or not."""

from __future__ import annotations

import asyncio
import getpass
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

from app.audit.keys import open_keys
from app.audit.log import EventLog
from app.audit.store import head_of
from app.auth.accounts import Accounts
from app.auth.passwords import Passwords
from app.cli.check_store import check_store
from app.database import Database
from app.database.private import make_private
from app.settings import load
from app.web.access import Person, Role
from bus.messages import Message

T = TypeVar("T")
ORIGIN = Message("command_line")


def who_calls() -> str | Message:
    """The user of this machine, for the events."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ORIGIN


def console() -> Person:
    """The user of this machine as the caller of an act: a user who can write the store has every role."""
    who = who_calls()
    return Person("" if isinstance(who, Message) else who, Role.ADMIN, "console")


def with_accounts(config: Path, work: Callable[[Accounts], Awaitable[T]]) -> T:
    """Run ``work`` on the accounts. Raises ConfigurationError, StoreError, CallerError in words."""
    settings = load(config)
    check_store(settings)
    make_private(settings.server.data)
    database = Database(settings.server.store, checkpoints=False)
    passwords = Passwords()

    async def run() -> T:
        keys = open_keys(settings.key_files, database.path, await database.read(head_of))
        buses = [bus.name for bus in settings.bus]
        events = EventLog(database, keys=keys)
        return await work(Accounts(database, passwords, events, buses=buses, site=settings.site.name))

    try:
        return asyncio.run(run())
    finally:
        passwords.close()
        database.close()
