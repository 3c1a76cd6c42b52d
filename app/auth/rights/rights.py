"""What every account may do now, in memory: looked up before each command of work that lasts.

A request is authorized when it comes. A restore, a batch or a change of the baud rate goes on for minutes
after that, and its account may be disabled meanwhile, also by the command line in another process.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import InitVar, dataclass, field

import structlog

from app.auth import store
from app.auth.rights import notices
from app.auth.rights.lasting import Rechecks
from app.database import Database, StoreConnection
from app.errors import Problem, StoreError
from app.web.admission.access import AccountSubscriber, Person, Role, account_of
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message

WATCH_EVERY_S = 0.5
FRESH_S = 1.0
"""What was read longer ago permits nothing before the store has been read again."""

USER_ENDED = Message("rights_user_ended")
TOKEN_ENDED = Message("rights_token_ended")
PASSWORD_CHANGED = Message("rights_password_changed")
ROLE_LOWERED = Message("rights_role_lowered")

_log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Standing:
    """The rights of one account. ``credential`` distinguishes it from an earlier one of the same name."""

    role: Role
    credential: str


def why_withdrawn(person: Person, standing: Standing | None) -> Message | None:
    """Why what a person began must stop; None while it may go on. ``standing``: of the account now."""
    is_token = person.via == "token"
    if standing is None:
        return TOKEN_ENDED if is_token else USER_ENDED
    if standing.credential != person.credential:
        return TOKEN_ENDED if is_token else PASSWORD_CHANGED
    return None if standing.role.includes(person.role) else ROLE_LOWERED


@dataclass(eq=False, repr=False)
class Rights:
    """Holds the rights of every account. ``on_changed`` takes what is called after each change that this
    process makes to accounts. ``rechecks``: makes open connections check theirs again."""

    _database: Database
    on_changed: InitVar[Callable[[AccountSubscriber], None]]
    rechecks: Rechecks = field(default_factory=Rechecks)
    clock: Clock = unix_now
    monotonic: MonotonicClock = monotonic_now
    _standings: Mapping[str, Standing] = field(default_factory=dict)
    _read_at: Monotonic = Monotonic(float("-inf"))
    _withdrawn: list[AccountSubscriber] = field(default_factory=list)
    _noticed: asyncio.Event = field(default_factory=asyncio.Event)
    _kept: str = ""

    def __post_init__(self, on_changed: Callable[[AccountSubscriber], None]) -> None:
        on_changed(self._on_account_change)

    def on_withdrawn(self, subscriber: AccountSubscriber) -> None:
        """Call ``subscriber`` with each account that may do less than before."""
        self._withdrawn.append(subscriber)

    async def check(self, person: Person) -> None:
        """Raises Problem 403 ``rights_withdrawn`` when the account of a person may no longer do what it could
        when the person was authenticated; StoreError when that cannot be known."""
        if not person.has_account:
            return
        if self.monotonic() - self._read_at > FRESH_S or self._why_withdrawn(person):
            await self.refresh()
        reason = self._why_withdrawn(person)
        if reason:
            raise Problem(403, "rights_withdrawn", reason, outcome="rights_withdrawn")

    async def refresh(self, kept: str = "") -> None:
        """Read the store now. ``kept``: the account of a user who has just chosen another password, which
        ends nothing. Raises StoreError."""
        began = self.monotonic()
        standings = await self._database.read(self._read)
        if began < self._read_at:
            return  # another read began later and is here already
        before, self._standings, self._read_at = self._standings, standings, began
        for account in before.keys() | standings.keys():
            if before.get(account) != standings.get(account):
                self.rechecks.now(account)
        lessened = [
            account
            for account, standing in before.items()
            if account != kept and _is_less(standing, standings.get(account))
        ]
        # Together: a store that cannot record what one subscriber did keeps no other from acting.
        await asyncio.gather(*(withdrawn(account) for account in lessened for withdrawn in self._withdrawn))

    async def _on_account_change(self, kept: str) -> None:
        # First: what acts on a withdrawal may wait for the disk. Of all: a change may end sessions alone.
        self.rechecks.now()
        await self.refresh(kept)

    def on_notice(self, text: str) -> None:
        """Another server, or this one, has changed an account: look again at once."""
        notice = notices.read(text)
        self.rechecks.now(notice.account or None)
        if notice.kind == "kept":
            self._kept = notice.account
        self._noticed.set()

    async def watch(self) -> None:
        """Run until canceled: apply what the command line and other servers change in the store, by their
        notices or, where none comes, by looking twice a second."""
        fault = ""
        while True:
            try:
                kept, self._kept = self._kept, ""
                await self.refresh(kept)
                fault = ""
            except StoreError as error:
                if str(error) != fault:
                    _log.error("rights not read", error=str(error))
                fault = str(error)
            with suppress(TimeoutError):
                async with asyncio.timeout(WATCH_EVERY_S):
                    await self._noticed.wait()
            self._noticed.clear()

    def _why_withdrawn(self, person: Person) -> Message | None:
        return why_withdrawn(person, self._standings.get(person.account))

    def _read(self, connection: StoreConnection) -> dict[str, Standing]:
        now = self.clock()
        return {
            user.name: Standing(user.role, user.credential)
            for user in store.users(connection)
            if not user.disabled
        } | {
            account_of(token.name, token=True): Standing(token.role, token.credential)
            for token in store.tokens(connection)
            if token.is_good(now)
        }


def _is_less(before: Standing, now: Standing | None) -> bool:
    if now is None or now.credential != before.credential:
        return True
    return not now.role.includes(before.role)
