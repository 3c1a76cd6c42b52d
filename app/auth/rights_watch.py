"""Rights that end outside of this process: ``lineside token revoke``, ``lineside user …``, and by expiry.

A request looks its rights up each time. What lasts longer (sockets, control of a line, a restore that runs)
is told when the rights of its account have changed, within :data:`LOOK_EVERY_S` and the time of two reads.
"""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Callable, Hashable, Mapping
from math import inf

from app.auth.accounts import Accounts
from app.database import Database
from app.web.access import account_of

LOOK_EVERY_S = 0.4

Standing = Mapping[str, Hashable]
"""By account, everything that its rights depend on."""


class RightsWatch:
    """Run :meth:`follow`. ``clock``: Unix time, by which tokens expire."""

    def __init__(
        self, database: Database, accounts: Accounts, clock: Callable[[], float] = time.time
    ) -> None:
        self._database = database
        self._accounts = accounts
        self._clock = clock
        self._version = self._own_changes = -1
        self._standing: Standing = {}
        self._next_expiry = inf

    async def follow(self) -> None:
        """Look now and then, and after each change made here, until cancelled."""
        while True:
            await self.look()
            if self._accounts.rechecks.count == self._own_changes:
                await asyncio.wait({self._accounts.rechecks.next()}, timeout=LOOK_EVERY_S)

    async def look(self) -> None:
        """Tell of every account whose rights changed or ended since the last look."""
        version, own = await self._database.foreign_version(), self._accounts.rechecks.count
        now = self._clock()
        is_foreign = version != self._version or now >= self._next_expiry
        if not is_foreign and own == self._own_changes:
            return
        before = self._standing
        self._standing, self._next_expiry = await self._database.read(lambda c: standing(c, now))
        self._version, self._own_changes = version, own
        changed = [account for account, was in before.items() if self._standing.get(account) != was]
        if is_foreign:
            await self._accounts.rights_ended(changed)


def standing(connection: sqlite3.Connection, now: float) -> tuple[Standing, float]:
    """Every account that may do something now, and when the next token expires."""
    found: dict[str, Hashable] = {}
    for name, role, disabled, secret_hash in connection.execute(
        "SELECT name, role, disabled, secret_hash FROM users"
    ):
        found[account_of(name, token=False)] = (role, disabled, secret_hash)
    next_expiry = inf
    for name, hash_, role, bus, expires_at in connection.execute(
        "SELECT name, hash, role, bus, expires_at FROM tokens WHERE expires_at IS NULL OR expires_at > ?",
        (now,),
    ):
        found[account_of(name, token=True)] = (hash_, role, bus)
        next_expiry = min(next_expiry, expires_at or inf)
    return found, next_expiry
