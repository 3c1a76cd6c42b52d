"""Users and tokens as an admin keeps them, by page and by command line. Each change is an event."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from app.audit.act import Performed
from app.audit.log import EventLog
from app.auth import acts, rules, store, strength
from app.auth.passwords import Passwords
from app.auth.store import Token, User
from app.database import Database
from app.errors import Problem
from app.web.access import AccountSubscriber, Person, Role, account_of, name_of
from bus.errors import CallerError
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, term


@dataclass(eq=False, repr=False)
class Accounts:
    """Every change takes ``by``: who makes it, whose role is checked here, and ``origin``: the address of a
    page, or the command line. ``buses``: those of the configuration, for the tokens of workers; ``site``: its
    name, which no password may contain. A change raises Problem 403 for a person without its role."""

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
        self, name: str, role: Role, password: str, *, by: Person, origin: str | Message
    ) -> None:
        """Add a person who signs in by a password. Raises CallerError."""
        acts.ADD_USER.check(by)
        rules.check_name(name)
        strength.check_password(password, user=name, site=self.site)
        user = User(name, role, False, "/", "", False, self._clock(), None)
        await self._add(user, password)
        await self._record(acts.ADD_USER.by(by, name=name, role=term(role)), origin)

    async def add_panel(
        self, name: str, role: Role, pin: str, home: str, *, by: Person, origin: str | Message
    ) -> None:
        """Add a panel on the wall, which signs in by a PIN. Raises CallerError."""
        acts.ADD_PANEL.check(by)
        rules.check_name(name)
        rules.check_panel_role(role)
        strength.check_pin(pin)
        rules.check_home(home)
        await self._add(User(name, role, True, home, "", False, self._clock(), None), pin)
        await self._record(acts.ADD_PANEL.by(by, name=name, role=term(role)), origin)

    async def set_role(self, name: str, role: Role, *, by: Person, origin: str | Message) -> None:
        """Raises CallerError for an unknown user, for the last admin, and for a panel above operator."""
        acts.SET_ROLE.check(by)

        def change(connection: sqlite3.Connection) -> bool:
            found = store.user(connection, name)
            if found is not None and found[0].panel:
                rules.check_panel_role(role)
            return store.set_role(connection, name, role)

        await self._change(name, change)
        await self._record(acts.SET_ROLE.by(by, name=name, role=term(role)), origin)

    async def set_disabled(self, name: str, disabled: bool, *, by: Person, origin: str | Message) -> None:
        """Refuse a user, or admit again. Raises CallerError for an unknown user and for the last admin."""
        act = acts.DISABLE_USER if disabled else acts.ENABLE_USER
        act.check(by)
        await self._change(name, lambda connection: store.set_disabled(connection, name, disabled))
        await self._record(act.by(by, name=name), origin)

    async def remove_user(self, name: str, *, by: Person, origin: str | Message) -> None:
        """Raises CallerError for an unknown user and for the last admin."""
        acts.REMOVE_USER.check(by)
        await self._change(name, lambda connection: store.remove_user(connection, name))
        await self._record(acts.REMOVE_USER.by(by, name=name), origin)

    async def set_password(self, name: str, password: str, *, by: Person, origin: str | Message) -> None:
        """Set the password of a user, or the PIN of a panel. Every session of the user ends. Raises
        CallerError."""
        acts.SET_PASSWORD.check(by)
        await self._set_password(name, password)
        await self._record(acts.SET_PASSWORD.by(by, name=name), origin)

    async def change_own_password(
        self, password: str, *, by: Person, origin: str | Message, keep: bytes
    ) -> None:
        """Set the password of the user who requests it. The session with the hash ``keep`` stays, every other
        one of the user ends. Raises CallerError."""
        acts.CHANGE_OWN_PASSWORD.check(by)
        check_has_own_password(by)
        await self._set_password(by.name, password, keep)
        await self._record(acts.CHANGE_OWN_PASSWORD.by(by, name=by.name), origin, kept=by.name)

    async def set_language(self, person: Person, language: str) -> None:
        """The language that the user chose; empty: that of the browser. Raises Problem 403 for a program."""
        check_is_user(person)
        await self._database.write(lambda connection: store.set_language(connection, person.name, language))

    async def create_token(
        self,
        name: str,
        role: Role,
        *,
        bus: str = "",
        expires_days: int | None = None,
        by: Person,
        origin: str | Message,
    ) -> str:
        """Create a token for a program, or with ``bus`` for the worker of that bus; without ``expires_days``
        it holds until it is revoked. Returns the secret, which is stored nowhere. Raises CallerError."""
        act = acts.CREATE_WORKER_TOKEN if bus else acts.CREATE_TOKEN
        act.check(by)
        rules.check_name(name)
        rules.check_token_bus(role, bus, self.buses)
        secret, now = rules.new_secret(), self._clock()
        expires_at = rules.token_expiry(now, expires_days)
        token = Token(0, name, role, by.name or str(origin), now, None, bus or None, expires_at)

        def add(connection: sqlite3.Connection) -> None:
            rules.check_distinct(name, (each.name for each in store.tokens(connection)))
            store.add_token(connection, rules.secret_hash(secret), token)

        try:
            await self._database.write(add)
        except sqlite3.IntegrityError:
            raise CallerError(Message.of("token_exists", name=name)) from None
        of_bus = {"bus": bus} if bus else {}
        await self._record(act.by(by, name=name, role=term(role), **of_bus), origin)
        return secret

    async def revoke_token(self, name: str, *, by: Person, origin: str | Message) -> None:
        """Raises CallerError for one that is not there."""
        acts.REVOKE_TOKEN.check(by)
        if not await self._database.write(lambda connection: store.revoke_token(connection, name)):
            raise CallerError(Message.of("no_such_token", name=name[:80]))
        await self._record(acts.REVOKE_TOKEN.by(by, name=name), origin)

    async def _add(self, user: User, secret: str) -> None:
        hashed = await self._passwords.hash(secret)

        def add(connection: sqlite3.Connection) -> None:
            rules.check_distinct(user.name, (each.name for each in store.users(connection)))
            store.add_user(connection, user, hashed)

        try:
            await self._database.write(add)
        except sqlite3.IntegrityError:
            raise CallerError(Message.of("user_exists", name=user.name)) from None

    async def _set_password(self, name: str, password: str, keep: bytes = b"") -> None:
        found = await self._database.read(lambda connection: store.user(connection, name))
        if found is None:
            raise CallerError(Message.of("no_such_user", name=name[:80]))
        if found[0].panel:
            strength.check_pin(password)
        else:
            strength.check_password(password, user=name, site=self.site)
        hashed = await self._passwords.hash(password)
        await self._change(name, lambda connection: store.set_secret(connection, name, hashed, keep))

    async def _change(self, name: str, change: Callable[[sqlite3.Connection], bool]) -> None:
        def guarded(connection: sqlite3.Connection) -> None:
            before = store.admins_left(connection)
            if not change(connection):
                raise CallerError(Message.of("no_such_user", name=name[:80]))
            if before and not store.admins_left(connection):
                raise CallerError(Message.of("last_admin", name=name))

        await self._database.write(guarded)

    async def _record(self, performed: Performed, origin: str | Message, kept: str = "") -> None:
        # A user of the machine who calls the command line may have no name.
        performed["who"], performed["origin"] = performed["who"] or origin, origin
        await self._events.record(**performed)
        for subscriber in self._subscribers:
            await subscriber(kept)


def check_is_user(person: Person) -> None:
    """Raises Problem 403 for a program, which may have the name of a user."""
    if person.via != "session":
        raise Problem(403, "forbidden", Message("no_account"))


def check_has_own_password(person: Person) -> None:
    """Raises Problem 403 for a program, and for a panel, whose PIN an admin changes."""
    check_is_user(person)
    if person.panel:
        raise Problem(403, "forbidden", Message("panel_pin_by_admin"))
