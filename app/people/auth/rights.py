"""The rights of every account now, in memory, and those that remain after a restore.

A request is authorized when it comes. A restore, a batch, a change of the baud rate or an open page continues
after that, and its account may be disabled meanwhile, also by the command line in another process. The rights
are looked up before each command of such work; all of it follows from one look at the store: twice a second,
and after each change that this process makes.

A store restored from a backup gets back no right that was withdrawn since. Sessions all end. A token holds
only if the present store knows it too, and a user may do what both stores allow, under the present password.
Without a present store with users in it, as on a new machine, it is unknown which tokens were revoked: all of
them are; users are as they were then.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import structlog

from app.core.database import Database, StoreConnection, StoreRow
from app.core.web.access import PEOPLE_ROLES, AccountSubscriber, Caller, Role, account_of
from app.errors import Problem, StoreError
from app.people.auth import store
from app.people.auth.store import CompanyAccount, Token, User
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message

WATCH_EVERY_S = 0.5
FRESH_S = 1.0
"""Rights that were read more seconds ago permit nothing until the store has been read again."""
RECHECK_S = 20.0
"""The seconds between an open connection's checks for rights that end by themselves, such as those of an idle
session."""

USER_ENDED = Message("rights_user_ended")
TOKEN_ENDED = Message("rights_token_ended")
PASSWORD_CHANGED = Message("rights_password_changed")
ROLE_LOWERED = Message("rights_role_lowered")

_log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Standing:
    """The rights of one account. ``credential`` distinguishes it from an earlier one of the same name;
    ``signed_in``: whether it is a user with a session."""

    role: Role
    credential: str
    signed_in: bool = False


def why_withdrawn(person: Caller, standing: Standing | None) -> Message | None:
    """Return why a task that a person began must stop; None while it may continue. ``standing``: that of the
    account now."""
    is_token = person.via == "token"
    if standing is None:
        return TOKEN_ENDED if is_token else USER_ENDED
    if standing.credential != person.credential:
        return TOKEN_ENDED if is_token else PASSWORD_CHANGED
    return None if standing.role.includes(person.role) else ROLE_LOWERED


@dataclass(eq=False, repr=False)
class Rights:
    """The rights of every account, in memory. ``changes``: how often one of them has changed."""

    _database: Database
    clock: Clock = unix_now
    monotonic: MonotonicClock = monotonic_now
    changes: int = 0
    _changed: asyncio.Event = field(default_factory=asyncio.Event)
    _standings: Mapping[str, Standing] = field(default_factory=dict)
    _tokens: Mapping[bytes, Token] = field(default_factory=dict)
    """The tokens by the hashes of their secrets."""
    _read_at: Monotonic = Monotonic(float("-inf"))
    _withdrawn: list[AccountSubscriber] = field(default_factory=list)

    def on_withdrawn(self, subscriber: AccountSubscriber) -> None:
        """Call ``subscriber`` with each account that may do less than before, or is signed in nowhere now."""
        self._withdrawn.append(subscriber)

    async def check(self, person: Caller) -> None:
        """Raise Problem 403 ``rights_withdrawn`` if the account of a person may no longer do what it could
        when the person was authenticated; StoreError if that cannot be known."""
        if not person.has_account:
            return
        if not self._is_fresh or self._why_withdrawn(person):
            await self.refresh()
        reason = self._why_withdrawn(person)
        if reason:
            raise Problem(403, "rights_withdrawn", reason, outcome="rights_withdrawn")

    def token(self, hash_: bytes) -> Token | None:
        """Return a token by the hash of its secret; None if only the store knows whether it exists."""
        return self._tokens.get(hash_) if self._is_fresh else None

    @property
    def _is_fresh(self) -> bool:
        return self.monotonic() - self._read_at <= FRESH_S

    def announce(self) -> None:
        """Make each open connection check again whether it is allowed."""
        self.changes += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def apply(self) -> None:
        """Apply an account's change or a session's end that this process has just stored. Raise
        StoreError."""
        # This goes first: the code that acts on a withdrawal may wait for the disk.
        self.announce()
        await self.refresh()

    async def refresh(self) -> None:
        """Read the store now. Raise StoreError."""
        began = self.monotonic()
        standings, tokens = await self._database.read(self._read)
        if began < self._read_at:
            return  # Another read began later and is here already.
        before, self._standings, self._tokens = self._standings, standings, tokens
        self._read_at = began
        if before != standings:
            self.announce()
        lessened = [
            account for account, standing in before.items() if _is_less(standing, standings.get(account))
        ]
        # They run together: a store that cannot record one subscriber's act keeps no other from acting.
        await asyncio.gather(*(withdrawn(account) for account in lessened for withdrawn in self._withdrawn))

    async def watch(self) -> None:
        """Run until canceled: apply changes that the command line makes in the store, and rights that
        expire."""
        fault = ""
        while True:
            try:
                await self.refresh()
                fault = ""
            except StoreError as error:
                if str(error) != fault:
                    _log.error("rights not read", error=str(error))
                fault = str(error)
            await asyncio.sleep(WATCH_EVERY_S)

    async def until_withdrawn(
        self, is_allowed: Callable[[], Awaitable[bool]], seen: int, every_s: float = RECHECK_S
    ) -> None:
        """Wait until ``is_allowed`` returns False; it is called at each change and every ``every_s``.
        ``seen``: the `changes` before it was allowed."""
        while True:
            if self.changes == seen:
                with suppress(TimeoutError):
                    async with asyncio.timeout(every_s):
                        await self._changed.wait()
            seen = self.changes
            if not await is_allowed():
                return

    def _why_withdrawn(self, person: Caller) -> Message | None:
        return why_withdrawn(person, self._standings.get(person.account))

    def _read(self, connection: StoreConnection) -> tuple[dict[str, Standing], dict[bytes, Token]]:
        now = self.clock()
        signed_in = store.signed_in(connection, now)
        users = {
            user.name: Standing(user.role, user.credential, user.name in signed_in)
            for user in store.users(connection)
            if not user.disabled
        }
        tokens = {hash_: token for hash_, token in store.token_hashes(connection) if token.is_good(now)}
        programs = {
            account_of(token.name, token=True): Standing(token.role, token.credential)
            for token in tokens.values()
        }
        return users | programs, tokens


def _is_less(before: Standing, now: Standing | None) -> bool:
    """Return whether an account lost something. A user who has chosen another password keeps a session, and
    with it everything."""
    if now is None or not now.role.includes(before.role):
        return True
    return not now.signed_in and (before.signed_in or now.credential != before.credential)


@dataclass(frozen=True, slots=True)
class Withheld:
    """The rights that a restored store lost, each by name, in order: tokens that are revoked, users that are
    disabled, users with a lower role than in the backup. ``admins``: how many admins can sign in."""

    tokens: tuple[str, ...]
    disabled: tuple[str, ...]
    lowered: tuple[str, ...]
    admins: int


@dataclass(frozen=True, slots=True)
class PresentUser:
    """A user of the present store."""

    role: Role
    panel: bool
    disabled: bool
    secret_hash: str
    company_account: CompanyAccount | None = None


@dataclass(frozen=True, slots=True)
class Present:
    """The rights in the present store: hashes of tokens, and users by name."""

    tokens: frozenset[bytes]
    users: dict[str, PresentUser]


def read_present(connection: StoreConnection) -> Present | None:
    """Read the rights in a store of any version; None from one without users. Raise StoreError for one that
    cannot be read."""
    tokens = frozenset(hash_ for (hash_,) in connection.execute("SELECT hash FROM tokens"))
    users = {
        row["name"]: PresentUser(
            Role(row["role"]),
            bool(row["panel"]),
            bool(row["disabled"]),
            row["secret_hash"],
            _company_account(row),
        )
        for row in connection.execute("SELECT * FROM users")
    }
    return Present(tokens, users) if users else None


def _company_account(row: StoreRow) -> CompanyAccount | None:
    """Return the company account of a row; None also in a store from before there were any."""
    if "issuer" not in row.keys() or row["issuer"] is None:  # noqa: SIM118
        return None
    return CompanyAccount(row["issuer"], row["subject"])


def withhold(restored: StoreConnection, present: Present | None, *, keep_tokens: bool = False) -> Withheld:
    """Remove from a restored store the rights withdrawn since its backup. ``present``: None if they are
    unknown."""
    restored.execute("DELETE FROM sessions")
    gone = [] if keep_tokens else _tokens_unknown(restored, present)
    restored.executemany("DELETE FROM tokens WHERE hash = ?", [(hash_,) for hash_, _ in gone])
    tokens = tuple(name for _, name in gone)
    disabled: list[str] = []
    lowered: list[str] = []
    for user in store.users(restored) if present is not None else ():
        now = present.users.get(user.name) if present is not None else None
        is_same = now is not None and (now.panel, now.company_account) == (user.panel, user.company_account)
        if now is None or now.disabled or not is_same:
            restored.execute("UPDATE users SET disabled = 1 WHERE name = ?", (user.name,))
            disabled += [] if user.disabled else [user.name]
        elif _take_over(restored, user, now):
            lowered.append(user.name)
    return Withheld(tokens, tuple(disabled), tuple(lowered), store.admins_left(restored))


def tokens_to_revoke(restored: StoreConnection, present: Present | None) -> list[str]:
    """Return the names of the tokens that `withhold` would revoke."""
    return [name for _, name in _tokens_unknown(restored, present)]


def _tokens_unknown(restored: StoreConnection, present: Present | None) -> list[tuple[bytes, str]]:
    known = frozenset[bytes]() if present is None else present.tokens
    rows = restored.execute("SELECT hash, name FROM tokens ORDER BY name").fetchall()
    return [(hash_, name) for hash_, name in rows if hash_ not in known]


def _take_over(restored: StoreConnection, user: User, now: PresentUser) -> bool:
    """Store the present password and the lower role. Return whether the role is lower than in the backup."""
    role = min(user.role, now.role, key=PEOPLE_ROLES.index)
    change = "UPDATE users SET role = ?, secret_hash = ? WHERE name = ?"
    restored.execute(change, (role, now.secret_hash, user.name))
    return role is not user.role
