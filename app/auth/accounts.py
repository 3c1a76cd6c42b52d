"""Users and tokens as an admin keeps them, by page and by command line. Each change is an event."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from app.audit.kinds import EventKind
from app.audit.log import EventLog
from app.auth import rules, store, strength
from app.auth.passwords import Passwords
from app.auth.store import Token, User
from app.database import Database
from app.web.access import AccountSubscriber, Role, account_of, name_of
from bus.errors import CallerError
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, term


@dataclass(eq=False, repr=False)
class Accounts:
    """Every change takes ``by``: who makes it, and ``origin``: by which way (page, cli). ``buses``: those of
    the configuration, for the tokens of workers; ``site``: its name, which no password may contain."""

    _database: Database
    _passwords: Passwords
    _events: EventLog
    _clock: Clock = unix_now
    buses: Collection[str] = ()
    site: str = ""
    _subscribers: list[AccountSubscriber] = field(default_factory=list)

    def now(self) -> UnixTime:
        """Unix time as this service has it, by which tokens expire."""
        return self._clock()

    def on_changed(self, subscriber: AccountSubscriber) -> None:
        """Call ``subscriber`` after each change. It gets the account of a user who chose another password and
        stays signed in, else an empty text."""
        self._subscribers.append(subscriber)

    async def users(self) -> list[User]:
        """All users and panels by name."""
        return await self._database.read(store.users)

    async def tokens(self) -> list[Token]:
        """All tokens by name, without what they are."""
        return await self._database.read(store.tokens)

    async def find(self, account: str) -> tuple[str, Role] | None:
        """The account of a name, and its role: a user who may sign in, else a token, which
        can also be named as such; None when there is none."""
        name, only_token = name_of(account)
        now = self._clock()

        def find(connection: sqlite3.Connection) -> tuple[str, Role] | None:
            user = None if only_token else store.user(connection, name)
            if user is not None and not user[0].disabled:
                return name, user[0].role
            tokens = (each for each in store.tokens(connection) if each.name == name and each.is_good(now))
            return next(((account_of(name, token=True), each.role) for each in tokens), None)

        return await self._database.read(find)

    async def add_user(
        self, name: str, role: Role, password: str, *, by: str | Message, origin: str | Message
    ) -> None:
        """Add a person who signs in by a password. Raises CallerError."""
        rules.check_name(name)
        strength.check_password(password, user=name, site=self.site)
        user = User(name, role, False, "/", "", False, self._clock(), None)
        await self._add(user, password)
        await self._note("user", Message.of("event_user_added", name=name, role=term(role)), by, origin)

    async def add_panel(
        self, name: str, role: Role, pin: str, home: str, *, by: str | Message, origin: str | Message
    ) -> None:
        """Add a panel on the wall, which signs in by a PIN. Raises CallerError."""
        rules.check_name(name)
        rules.check_panel_role(role)
        strength.check_pin(pin)
        rules.check_home(home)
        await self._add(User(name, role, True, home, "", False, self._clock(), None), pin)
        await self._note("user", Message.of("event_panel_added", name=name, role=term(role)), by, origin)

    async def set_role(self, name: str, role: Role, *, by: str | Message, origin: str | Message) -> None:
        """Raises CallerError for an unknown user, for the last admin, and for a panel above operator."""

        def change(connection: sqlite3.Connection) -> bool:
            found = store.user(connection, name)
            if found is not None and found[0].panel:
                rules.check_panel_role(role)
            return store.set_role(connection, name, role)

        await self._change(name, change)
        await self._note("user", Message.of("event_role_changed", name=name, role=term(role)), by, origin)

    async def set_disabled(
        self, name: str, disabled: bool, *, by: str | Message, origin: str | Message
    ) -> None:
        """Refuse a user, or admit again. Raises CallerError for an unknown user and for the last admin."""
        await self._change(name, lambda connection: store.set_disabled(connection, name, disabled))
        refused, admitted = (
            Message.of("event_user_refused", name=name),
            Message.of("event_user_admitted", name=name),
        )
        await self._note("user", refused if disabled else admitted, by, origin)

    async def remove_user(self, name: str, *, by: str | Message, origin: str | Message) -> None:
        """Raises CallerError for an unknown user and for the last admin."""
        await self._change(name, lambda connection: store.remove_user(connection, name))
        await self._note("user", Message.of("event_user_removed", name=name), by, origin)

    async def set_password(
        self, name: str, password: str, *, by: str | Message, origin: str | Message, keep: bytes = b""
    ) -> None:
        """Set a password, or the PIN of a panel. Every session of the user ends, but the one with the hash
        ``keep``. Raises CallerError."""
        found = await self._database.read(lambda connection: store.user(connection, name))
        if found is None:
            raise CallerError(Message.of("no_such_user", name=name[:80]))
        if found[0].panel:
            strength.check_pin(password)
        else:
            strength.check_password(password, user=name, site=self.site)
        hashed = await self._passwords.hash(password)
        await self._change(name, lambda connection: store.set_secret(connection, name, hashed, keep))
        what = Message.of("event_password_changed", name=name)
        await self._note("user", what, by, origin, kept=name if keep else "")

    async def set_language(self, name: str, language: str) -> None:
        """The language that the user chose; empty: that of the browser."""
        await self._database.write(lambda connection: store.set_language(connection, name, language))

    async def create_token(
        self,
        name: str,
        role: Role,
        *,
        bus: str = "",
        expires_days: int | None = None,
        by: str | Message,
        origin: str | Message,
    ) -> str:
        """Create a token for a program, or with ``bus`` for the worker of that bus; without ``expires_days``
        it holds until it is revoked. Returns the secret, which is stored nowhere. Raises CallerError."""
        rules.check_name(name)
        rules.check_token_bus(role, bus, self.buses)
        secret, now = rules.new_secret(), self._clock()
        expires_at = rules.token_expiry(now, expires_days)
        token = Token(0, name, role, str(by), now, None, bus or None, expires_at)

        def add(connection: sqlite3.Connection) -> None:
            rules.check_distinct(name, (each.name for each in store.tokens(connection)))
            store.add_token(connection, rules.secret_hash(secret), token)

        try:
            await self._database.write(add)
        except sqlite3.IntegrityError:
            raise CallerError(Message.of("token_exists", name=name)) from None
        what = Message.of("event_token_created", name=name, role=term(role))
        if bus:
            what = Message.of("event_token_of_bus_created", name=name, role=term(role), bus=bus)
        await self._note("token", what, by, origin)
        return secret

    async def revoke_token(self, name: str, *, by: str | Message, origin: str | Message) -> None:
        """Raises CallerError for one that is not there."""
        if not await self._database.write(lambda connection: store.revoke_token(connection, name)):
            raise CallerError(Message.of("no_such_token", name=name[:80]))
        await self._note("token", Message.of("event_token_revoked", name=name), by, origin)

    async def _add(self, user: User, secret: str) -> None:
        hashed = await self._passwords.hash(secret)

        def add(connection: sqlite3.Connection) -> None:
            rules.check_distinct(user.name, (each.name for each in store.users(connection)))
            store.add_user(connection, user, hashed)

        try:
            await self._database.write(add)
        except sqlite3.IntegrityError:
            raise CallerError(Message.of("user_exists", name=user.name)) from None

    async def _change(self, name: str, change: Callable[[sqlite3.Connection], bool]) -> None:
        def guarded(connection: sqlite3.Connection) -> None:
            before = store.admins_left(connection)
            if not change(connection):
                raise CallerError(Message.of("no_such_user", name=name[:80]))
            if before and not store.admins_left(connection):
                raise CallerError(Message.of("last_admin", name=name))

        await self._database.write(guarded)

    async def _note(
        self, kind: EventKind, what: Message, by: str | Message, origin: str | Message, kept: str = ""
    ) -> None:
        await self._events.record(kind=kind, what=what, who=by, origin=origin)
        for subscriber in self._subscribers:
            await subscriber(kept)
