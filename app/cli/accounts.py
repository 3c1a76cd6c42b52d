"""The store of users and tokens from the command line, whether the dashboard runs or not."""

from __future__ import annotations

import asyncio
import getpass
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

from app.audit.log import EventLog
from app.auth.accounts import Accounts
from app.auth.passwords import Passwords
from app.database import Database
from app.settings import load

T = TypeVar("T")
ORIGIN = "command line"


def who_calls() -> str:
    """The user of this machine, for the events."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "command line"


def with_accounts(config: Path, work: Callable[[Accounts], Awaitable[T]]) -> T:
    """Run ``work`` on the accounts. Raises ConfigurationError, StoreError, CallerError in words."""
    settings = load(config)
    database = Database(settings.server.store, checkpoints=False)
    passwords = Passwords()

    async def run() -> T:
        buses = [bus.name for bus in settings.bus]
        accounts = Accounts(database, passwords, EventLog(database), buses=buses, site=settings.site.name)
        return await work(accounts)

    try:
        return asyncio.run(run())
    finally:
        passwords.close()
        database.close()
