"""The users and tokens of a site: an admin manages them by page and by command line, and each user the own
account. Each change is an event."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace

from app.core.database import Database, StoreConnection
from app.core.web.access import Person, Role, account_of, name_of
from app.errors import ConstraintError, Problem
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.people.auth import rules, store
from app.people.auth.passwords import check_secret, hash_secret
from app.people.auth.store import CompanyAccount, Token, User
from bus.errors import CallerError
from bus.instants import Clock, unix_now
from bus.messages import Message, ParamValue, term


@dataclass(eq=False, repr=False)
class Accounts:
    """The users and tokens of a site. Every change takes ``by``, the person who makes it, whose role is
    checked here, and raises Problem 403 for a person without the role. ``buses``: those of the configuration,
    for the tokens of workers; ``site``: its name, which no password may contain."""

    _database: Database
    _events: EventLog
    _clock: Clock = unix_now
    buses: Collection[str] = ()
    site: str = ""
    _subscribers: list[Callable[[], Awaitable[None]]] = field(default_factory=list)

    def on_changed(self, subscriber: Callable[[], Awaitable[None]]) -> None:
        """Call ``subscriber`` after each change."""
        self._subscribers.append(subscriber)

    async def users(self) -> list[User]:
        """Return all users and panels by name."""
        return await self._database.read(store.users)

    async def tokens(self) -> list[Token]:
        """Return all tokens by name, without their secrets."""
        return await self._database.read(store.tokens)

    async def find(self, account: str) -> tuple[str, Role] | None:
        """Return the account with a name, and its role: the user who may sign in, or the token if there is no
        such user or ``account`` names a token as such; None if there is neither."""
        name, only_token = name_of(account)
        now = self._clock()

        def find(connection: StoreConnection) -> tuple[str, Role] | None:
            user = None if only_token else store.user(connection, name)
            if user is not None and not user[0].disabled:
                return name, user[0].role
            tokens = (each for each in store.tokens(connection) if each.name == name and each.is_good(now))
            return next(((account_of(name, token=True), each.role) for each in tokens), None)

        return await self._database.read(find)

    async def add_user(self, name: str, role: Role, password: str, *, by: Person) -> None:
        """Add a person who signs in by a password. Raise CallerError."""
        async with self._performing(ADD_USER, by, name=name, role=term(role)):
            await self._add(User(name, role, False, "/", "", False, self._clock(), None), password)

    async def add_first_admin(self, name: str, password: str, *, address: str) -> None:
        """Add the first user with a password, an admin who acts from ``address``. Raise Problem 409 if there
        is a user already, and CallerError for a name or password that is refused."""
        by = Person(name, Role.ADMIN, "session", address=address)
        async with self._performing(ADD_FIRST_ADMIN, by, name=name):
            user = User(name, Role.ADMIN, False, "/", "", False, self._clock(), None)
            await self._add(user, password, is_first=True)

    async def add_panel(self, name: str, role: Role, pin: str, home: str, *, by: Person) -> None:
        """Add a panel on the wall, which signs in by a PIN. Raise CallerError."""
        async with self._performing(ADD_PANEL, by, name=name, role=term(role)):
            await self._add(User(name, role, True, home, "", False, self._clock(), None), pin)

    async def follow_provider(self, account: CompanyAccount, name: str, role: Role, *, address: str) -> User:
        """Return the user of a company account, with the role of its groups. It is added at the first
        sign-in, with a name that no other user has; a disabled user is left as is. Raise CallerError."""

        def follow(connection: StoreConnection) -> tuple[User, Message | None]:
            there = store.user_of(connection, account)
            if there is None:
                return self._add_of_provider(connection, account, name, role)
            if there.disabled or there.role is role:
                return there, None
            store.set_role(connection, there.name, role)
            what = Message.of("event_role_followed", name=there.name, role=term(role))
            return replace(there, role=role), what

        user, what = await self._database.write(follow)
        if what is not None:
            await self._events.record(kind="user", what=what, who=user.name, origin=address)
            for subscriber in self._subscribers:
                await subscriber()
        return user

    async def set_role(self, name: str, role: Role, *, by: Person) -> None:
        """Change the role of a user. Raise CallerError for an unknown user, for the last admin, for a panel
        above operator, and for the user of a company account, whose role follows the groups there."""

        def change(connection: StoreConnection) -> bool:
            found = store.user(connection, name)
            if found is not None and found[0].company_account is not None:
                raise CallerError(Message.of("role_of_company_account", name=name))
            if found is not None and found[0].panel:
                rules.check_panel_role(role)
            return store.set_role(connection, name, role)

        async with self._performing(SET_ROLE, by, name=name, role=term(role)):
            await self._change(name, change)

    async def set_disabled(self, name: str, disabled: bool, *, by: Person) -> None:
        """Disable a user, or enable again. Raise CallerError for an unknown user and for the last admin."""
        async with self._performing(DISABLE_USER if disabled else ENABLE_USER, by, name=name):
            await self._change(name, lambda connection: store.set_disabled(connection, name, disabled))

    async def remove_user(self, name: str, *, by: Person) -> None:
        """Remove a user. Raise CallerError for an unknown user and for the last admin."""
        async with self._performing(REMOVE_USER, by, name=name):
            await self._change(name, lambda connection: store.remove_user(connection, name))

    async def set_password(self, name: str, password: str, *, by: Person) -> None:
        """Set the password of a user, or the PIN of a panel. Every session of the user ends. Raise
        CallerError."""
        async with self._performing(SET_PASSWORD, by, name=name):
            await self._set_password(name, password)

    async def change_own_password(self, password: str, *, by: Person, keep: bytes) -> None:
        """Set the password of the user who requests it. The session with the hash ``keep`` stays, every other
        one of the user ends. Raise CallerError."""
        async with self._performing(CHANGE_OWN_PASSWORD, by, name=by.name):
            check_has_own_password(by)
            await self._set_password(by.name, password, keep)

    async def set_language(self, person: Person, language: str) -> None:
        """Store the language that the user chose; empty: that of the browser. Raise Problem 403 for a
        program."""
        _check_is_user(person)
        await self._database.write(lambda connection: store.set_language(connection, person.name, language))

    async def create_token(
        self, name: str, role: Role, *, bus: str = "", expires_days: int | None = None, by: Person
    ) -> str:
        """Create a token for a program, or with ``bus`` for the worker of that bus; without ``expires_days``
        it holds until it is revoked. Return the secret, which is stored nowhere. Raise CallerError."""
        secret, now = rules.new_secret(), self._clock()
        act, of_bus = (CREATE_WORKER_TOKEN, {"bus": bus}) if bus else (CREATE_TOKEN, {})
        async with self._performing(act, by, name=name, role=term(role), **of_bus):
            rules.check_name(name)
            rules.check_token_bus(role, bus, self.buses)
            expires_at = rules.token_expiry(now, expires_days)
            token = Token(0, name, role, by.name or str(by.address), now, None, bus or None, expires_at)

            def add(connection: StoreConnection) -> None:
                rules.check_distinct(name, (each.name for each in store.tokens(connection)))
                store.add_token(connection, rules.secret_hash(secret), token)

            await self._write_new(add, Message.of("token_exists", name=name))
        return secret

    async def revoke_token(self, name: str, *, by: Person) -> None:
        """Revoke a token. Raise CallerError for an unknown one."""
        async with self._performing(REVOKE_TOKEN, by, name=name):
            if not await self._database.write(lambda connection: store.revoke_token(connection, name)):
                raise CallerError(Message.of("no_such_token", name=name[:80]))

    @asynccontextmanager
    async def _performing(self, act: Act, by: Person, **params: ParamValue) -> AsyncIterator[None]:
        """Check the role of ``by``; once the act is done, record it with ``params`` and call the
        subscribers."""
        act.check(by)
        yield
        performed = act.by(by, **params)
        # A user of the machine who calls the command line may have no name.
        performed["who"], performed["origin"] = by.name or by.address, by.address
        await self._events.record(**performed)
        for subscriber in self._subscribers:
            await subscriber()

    async def _add(self, user: User, secret: str, *, is_first: bool = False) -> None:
        rules.check_name(user.name)
        if user.panel:
            rules.check_panel_role(user.role)
        check_secret(secret, user=user.name, panel=user.panel, site=self.site)
        rules.check_home(user.home)
        hashed = await hash_secret(secret)

        def add(connection: StoreConnection) -> None:
            if is_first and store.has_own_users(connection):
                raise Problem(409, "not_in_state", Message("first_admin_exists"))
            rules.check_distinct(user.name, (each.name for each in store.users(connection)))
            store.add_user(connection, user, hashed)

        await self._write_new(add, Message.of("user_exists", name=user.name))

    def _add_of_provider(
        self, connection: StoreConnection, account: CompanyAccount, name: str, role: Role
    ) -> tuple[User, Message]:
        rules.check_name(name)
        names = [each.name for each in store.users(connection)]
        if name in names:
            raise CallerError(Message.of("user_exists", name=name))
        rules.check_distinct(name, names)
        user = User(name, role, False, "/", "", False, self._clock(), None, company_account=account)
        store.add_user(connection, user, "")
        return user, Message.of("event_user_of_company_added", name=name, role=term(role))

    async def _write_new(self, add: Callable[[StoreConnection], None], exists: Message) -> None:
        try:
            await self._database.write(add)
        except ConstraintError:
            raise CallerError(exists) from None

    async def _set_password(self, name: str, password: str, keep: bytes = b"") -> None:
        found = await self._database.read(lambda connection: store.user(connection, name))
        if found is None:
            raise CallerError(Message.of("no_such_user", name=name[:80]))
        if found[0].company_account is not None:
            raise CallerError(Message.of("no_password_of_company_account", name=name))
        check_secret(password, user=name, panel=found[0].panel, site=self.site)
        hashed = await hash_secret(password)
        await self._change(name, lambda c: store.set_secret(c, name, hashed, keep))

    async def _change(self, name: str, change: Callable[[StoreConnection], bool]) -> None:
        def guarded(connection: StoreConnection) -> None:
            before = store.admins_left(connection)
            if not change(connection):
                raise CallerError(Message.of("no_such_user", name=name[:80]))
            if before and not store.admins_left(connection):
                raise CallerError(Message.of("last_admin", name=name))

        await self._database.write(guarded)


def _check_is_user(person: Person) -> None:
    """Raise Problem 403 for a program, which may have the name of a user."""
    if person.via != "session":
        raise Problem(403, "forbidden", Message("no_account"))


def check_has_own_password(person: Person) -> None:
    """Raise Problem 403 for a program, for the user of a company account, and for a panel, whose PIN an admin
    changes."""
    _check_is_user(person)
    if person.has_company_account:
        raise Problem(403, "forbidden", Message.of("no_password_of_company_account", name=person.name))
    if person.panel:
        raise Problem(403, "forbidden", Message("panel_pin_by_admin"))


ADD_USER = Act("add_user", Role.ADMIN, "user", "event_user_added")
ADD_FIRST_ADMIN = Act("add_first_admin", Role.ADMIN, "user", "event_first_admin_added")
ADD_PANEL = Act("add_panel", Role.ADMIN, "user", "event_panel_added")
SET_ROLE = Act("set_role", Role.ADMIN, "user", "event_role_changed")
DISABLE_USER = Act("disable_user", Role.ADMIN, "user", "event_user_refused")
ENABLE_USER = Act("enable_user", Role.ADMIN, "user", "event_user_admitted")
SET_PASSWORD = Act("set_password", Role.ADMIN, "user", "event_password_changed")
REMOVE_USER = Act("remove_user", Role.ADMIN, "user", "event_user_removed")
CREATE_TOKEN = Act("create_token", Role.ADMIN, "token", "event_token_created")
CREATE_WORKER_TOKEN = Act("create_worker_token", Role.ADMIN, "token", "event_token_of_bus_created")
REVOKE_TOKEN = Act("revoke_token", Role.ADMIN, "token", "event_token_revoked")
CHANGE_OWN_PASSWORD = Act("change_own_password", Role.VIEWER, "user", "event_password_changed")
LOG_OUT = Act("log_out", Role.VIEWER, "logout", "event_signed_out")

_OF_USERS = (ADD_USER, ADD_PANEL, SET_ROLE, DISABLE_USER, ENABLE_USER, SET_PASSWORD, REMOVE_USER)
_OF_TOKENS = (CREATE_TOKEN, CREATE_WORKER_TOKEN, REVOKE_TOKEN)
ACTS = (*_OF_USERS, *_OF_TOKENS, CHANGE_OWN_PASSWORD, LOG_OUT)
