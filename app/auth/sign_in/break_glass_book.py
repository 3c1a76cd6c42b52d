"""Making and removing break-glass accounts, by the command line. Each change is an event."""

from __future__ import annotations

from pathlib import Path

from app.audit.acts import Performed
from app.audit.log import EventLog
from app.auth import rules
from app.auth.accounts import Accounts
from app.auth.acts import MAKE_BREAK_GLASS, REMOVE_BREAK_GLASS
from app.auth.sign_in import strength
from app.auth.sign_in.break_glass import (
    MAX_ACCOUNTS,
    ROLES,
    new_account,
    path_in,
    read_accounts,
    write_accounts,
)
from app.web.admission.access import Person, role_named
from bus.errors import CallerError
from bus.instants import Clock, unix_now
from bus.messages import Message, term


class BreakGlassBook:
    """The accounts in the file of a data folder. ``site``: its name, which no password may contain."""

    def __init__(
        self, data: Path, accounts: Accounts, events: EventLog, site: str, clock: Clock = unix_now
    ) -> None:
        self._path = path_in(data)
        self._accounts = accounts
        self._events = events
        self._site = site
        self._clock = clock

    async def put(self, name: str, role: str, password: str, *, by: Person) -> None:
        """Make an account, or give it another role and password. Raises CallerError, StoreError."""
        MAKE_BREAK_GLASS.check(by)
        chosen = role_named(role, ROLES)
        rules.check_name(name)
        rules.check_distinct(name, [user.name for user in await self._accounts.users()])
        if await self._accounts.find(name) is not None:
            raise CallerError(Message.of("user_exists", name=name))
        strength.check_secret(password, user=name, panel=False, site=self._site)
        kept = read_accounts(self._path)
        if name not in kept and len(kept) >= MAX_ACCOUNTS:
            raise CallerError(Message.of("break_glass_too_many", most=MAX_ACCOUNTS))
        account = await new_account(name, chosen, password, self._clock())
        # Recorded first: there is no account that the audit log does not know of.
        await self._record(by, MAKE_BREAK_GLASS.by(by, name=name, role=term(chosen)))
        write_accounts(self._path, {**kept, name: account})

    async def remove(self, name: str, *, by: Person) -> None:
        """Remove an account. Raises CallerError for one that is not there, StoreError."""
        REMOVE_BREAK_GLASS.check(by)
        kept = read_accounts(self._path)
        if kept.pop(name, None) is None:
            raise CallerError(Message.of("no_such_break_glass", name=name[:80]))
        write_accounts(self._path, kept)
        await self._record(by, REMOVE_BREAK_GLASS.by(by, name=name))

    async def _record(self, by: Person, performed: Performed) -> None:
        performed["who"], performed["origin"] = by.name or by.address, by.address
        await self._events.record(**performed)
