"""Users and tokens as an admin keeps them, by page and by command line. Each change is an event."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Awaitable, Callable

from app.audit.kinds import Kind
from app.audit.log import EventLog
from app.auth import rules, store
from app.auth.passwords import Passwords
from app.auth.store import Token, User
from app.database import Database
from app.web.access import Role, account_of, name_of
from bus.errors import CallerError

Ended = Callable[[str], Awaitable[None]]


class Accounts:
    """Every change takes ``by``: who makes it, and ``origin``: by which way (page, cli)."""

    def __init__(
        self,
        database: Database,
        passwords: Passwords,
        events: EventLog,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._database = database
        self._passwords = passwords
        self._events = events
        self._clock = clock
        self._subscribers: list[Ended] = []

    def on_rights_changed(self, subscriber: Ended) -> None:
        """Hear the account of each user or token whose rights changed or ended, to close what is open."""
        self._subscribers.append(subscriber)

    async def users(self) -> list[User]:
        """All users and panels by name."""
        return await self._database.read(store.users)

    async def tokens(self) -> list[Token]:
        """All tokens by name, without what they are."""
        return await self._database.read(store.tokens)

    async def find(self, said: str) -> tuple[str, Role] | None:
        """The account that somebody names, and what it may do: a user who may sign in, else a token, which
        can also be named as such; None when there is none."""
        name, only_token = name_of(said)

        def find(connection: sqlite3.Connection) -> tuple[str, Role] | None:
            user = None if only_token else store.user(connection, name)
            if user is not None and not user[0].disabled:
                return name, user[0].role
            tokens = (token for token in store.tokens(connection) if token.name == name)
            return next(((account_of(name, token=True), token.role) for token in tokens), None)

        return await self._database.read(find)

    async def add_user(self, name: str, role: Role, password: str, *, by: str, origin: str) -> None:
        """Somebody new. Raises CallerError."""
        rules.check_name(name)
        user = User(name, role, False, "/", "", False, self._clock(), None)
        await self._add(user, password)
        await self._note("user", f"user {name} added as {role}", by, origin)

    async def add_panel(self, name: str, role: Role, pin: str, home: str, *, by: str, origin: str) -> None:
        """A panel on the wall that signs in by a PIN. Raises CallerError."""
        rules.check_name(name)
        rules.check_pin(pin)
        rules.check_home(home)
        await self._add(User(name, role, True, home, "", False, self._clock(), None), pin)
        await self._note("user", f"panel {name} added as {role}", by, origin)

    async def set_role(self, name: str, role: Role, *, by: str, origin: str) -> None:
        """Raises CallerError for nobody and for the last admin."""
        await self._change(name, lambda connection: store.set_role(connection, name, role))
        await self._note("user", f"user {name} is {role} now", by, origin, name)

    async def set_disabled(self, name: str, disabled: bool, *, by: str, origin: str) -> None:
        """Refuse a user, or admit again. Raises CallerError for nobody and for the last admin."""
        await self._change(name, lambda connection: store.set_disabled(connection, name, disabled))
        words = "is refused from now on" if disabled else "may sign in again"
        await self._note("user", f"user {name} {words}", by, origin, name)

    async def remove_user(self, name: str, *, by: str, origin: str) -> None:
        """Raises CallerError for nobody and for the last admin."""
        await self._change(name, lambda connection: store.remove_user(connection, name))
        await self._note("user", f"user {name} removed", by, origin, name)

    async def set_password(self, name: str, password: str, *, by: str, origin: str) -> None:
        """A new password or PIN; every session of the user ends. Raises CallerError."""
        hashed = await self._passwords.hash(password)
        await self._change(name, lambda connection: store.set_secret(connection, name, hashed))
        await self._note("user", f"user {name} has a new password", by, origin, name)

    async def set_language(self, name: str, language: str) -> None:
        """The user's own wish; empty: what the browser asks for."""
        await self._database.write(lambda connection: store.set_language(connection, name, language))

    async def create_token(self, name: str, role: Role, *, by: str, origin: str) -> str:
        """A token for a program; this is the only time that it is seen. Raises CallerError."""
        rules.check_name(name)
        secret = rules.new_secret()
        token = Token(0, name, role, by, self._clock(), None)
        try:
            await self._database.write(
                lambda connection: store.add_token(connection, rules.secret_hash(secret), token)
            )
        except sqlite3.IntegrityError:
            detail = "there is a token {name} already; revoke it or take another name"
            raise CallerError(detail, params={"name": name}) from None
        await self._note("token", f"token {name} created as {role}", by, origin)
        return secret

    async def revoke_token(self, name: str, *, by: str, origin: str) -> None:
        """Raises CallerError for one that is not there."""
        if not await self._database.write(lambda connection: store.revoke_token(connection, name)):
            raise CallerError("there is no token {name}", params={"name": name})
        await self._note("token", f"token {name} revoked", by, origin, name)

    async def _add(self, user: User, secret: str) -> None:
        hashed = await self._passwords.hash(secret)
        try:
            await self._database.write(lambda connection: store.add_user(connection, user, hashed))
        except sqlite3.IntegrityError:
            detail = "there is a user {name} already; take another name"
            raise CallerError(detail, params={"name": user.name}) from None

    async def _change(self, name: str, change: Callable[[sqlite3.Connection], bool]) -> None:
        def guarded(connection: sqlite3.Connection) -> None:
            before = store.admins_left(connection)
            if not change(connection):
                raise CallerError("there is no user {name}", params={"name": name})
            if before and not store.admins_left(connection):
                detail = "{name} is the last admin; make somebody else admin first"
                raise CallerError(detail, params={"name": name})

        await self._database.write(guarded)

    async def _note(self, kind: Kind, what: str, by: str, origin: str, *ended: str) -> None:
        await self._events.record(kind=kind, what=what, who=by, origin=origin)
        for name in ended:
            for subscriber in self._subscribers:
                await subscriber(account_of(name, token=kind == "token"))
