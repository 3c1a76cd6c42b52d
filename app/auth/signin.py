"""Signing in and out, and who a cookie or a bearer token stands for."""

from __future__ import annotations

import asyncio
import hmac
import sqlite3
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime

from app.audit.log import EventLog
from app.auth import rules, store
from app.auth.failures import WINDOW_S, Failures
from app.auth.passwords import Passwords
from app.auth.rights import credential_of_token, credential_of_user
from app.auth.store import Session, User
from app.database import Database
from app.errors import Problem, StoreError
from app.web.access import Person, Role

Gone = Callable[[str], Awaitable[None]]
RETRY_AFTER_S = str(round(WINDOW_S))


_WRONG = {False: "the name or the password is not right", True: "the name or the PIN is not right"}
"""What a person is told, and what somebody at a panel."""


class SignIn:
    """Sessions of people and panels, tokens of programs."""

    def __init__(
        self,
        database: Database,
        passwords: Passwords,
        events: EventLog,
        worker_tokens: Mapping[str, str] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._database = database
        self._passwords = passwords
        self._events = events
        self._clock = clock
        self._failures = Failures()
        self._one_at_a_time = asyncio.Lock()
        self._worker_tokens = worker_tokens or {}
        """By bus, of the workers that this server starts itself; they end with the server."""
        self.on_gone: Gone | None = None
        """Hears the name of whoever is signed in nowhere any more."""

    async def sign_in(self, name: str, secret: str, address: str, *, panel: bool = False) -> str:
        """The cookie of a new session. Raises Problem 401, and 429 after too many failures."""
        async with self._one_at_a_time:
            self._refuse_too_many(name, address, panel)
            user = await self._verified(name, secret, panel)
            if user is None:
                await self._failed(name, address)
                raise Problem(401, "unauthorized", _WRONG[panel])
        self._failures.forget(name)
        return await self._begin(user, address)

    async def sign_out(self, cookie: str, person: Person, address: str) -> None:
        """End the session."""
        await self._end(rules.secret_hash(cookie), person.name)
        await self._events.record(kind="logout", what="signed out", who=person.name, origin=address)

    async def is_secret_of(self, name: str, secret: str) -> bool:
        """Whether it is the user's present password."""
        return await self._verified(name, secret, panel=False) is not None

    async def nobody_can_sign_in(self) -> bool:
        """Whether there is no user yet."""
        return not await self._database.read(store.users)

    async def by_cookie(self, cookie: str, *, is_use: bool = True) -> Person | None:
        """Who a session cookie stands for; None when it is over or was never good.

        ``is_use`` False: the look prolongs nothing.
        """
        hash_ = rules.secret_hash(cookie)
        session = await self._database.read(lambda connection: store.session(connection, hash_))
        now = self._clock()
        if session is None or session.user.disabled:
            return None
        if session.expires_at <= now:
            await self._end(hash_, session.user.name)
            return None
        if is_use:
            await self._note_use(hash_, session, now)
        user = session.user
        credential = credential_of_user(user, session.secret_hash)
        return Person(
            user.name,
            user.role,
            "session",
            user.language,
            user.panel,
            user.home,
            user.created_at,
            credential=credential,
        )

    async def by_token(self, bearer: str) -> Person | None:
        """Who a bearer token stands for. Raises Problem 401 for one that has expired, which says so."""
        for bus, own in self._worker_tokens.items():
            if hmac.compare_digest(bearer.encode(), own.encode()):
                return Person("worker", Role.WORKER, "worker", bus=bus)
        hash_ = rules.secret_hash(bearer)
        token = await self._database.read(lambda connection: store.token(connection, hash_))
        if token is None:
            return None
        now = self._clock()
        if token.expires_at is not None and token.expires_at <= now:
            raise _expired(token.name, token.expires_at)
        if token.used_at is None or now - token.used_at > rules.USE_NOTED_EVERY_S:
            number = token.id
            await self._note(lambda connection: store.note_token_used(connection, number, now))
        return Person(
            token.name,
            token.role,
            "token",
            created_at=token.created_at,
            bus=token.bus or "",
            credential=credential_of_token(token),
        )

    async def _verified(self, name: str, secret: str, panel: bool) -> User | None:
        found = await self._database.read(lambda connection: store.user(connection, name))
        user, stored = found if found else (None, None)
        if not await self._passwords.verify(stored, secret[: rules.LONGEST_PASSWORD + 1]):
            return None
        return user if user and user.panel is panel and not user.disabled else None

    async def _begin(self, user: User, address: str) -> str:
        cookie, now = rules.new_secret(), self._clock()
        hash_, ends = rules.secret_hash(cookie), _lifetime(user).ends_at(now, now)
        await self._database.write(
            lambda connection: store.begin_session(connection, hash_, user.name, now, ends)
        )
        await self._events.record(kind="login", what="signed in", who=user.name, origin=address)
        return cookie

    async def _end(self, hash_: bytes, name: str) -> None:
        now = self._clock()
        was_last = await self._database.write(
            lambda connection: store.end_session(connection, hash_, name, now)
        )
        if was_last and self.on_gone is not None:
            await self.on_gone(name)

    async def _note_use(self, hash_: bytes, session: Session, now: float) -> None:
        if now - session.used_at < rules.USE_NOTED_EVERY_S:
            return
        ends = _lifetime(session.user).ends_at(session.created_at, now)
        await self._note(lambda connection: store.prolong_session(connection, hash_, now, ends))

    async def _note(self, work: Callable[[sqlite3.Connection], None]) -> None:
        """When somebody was last here. On a disk that takes nothing the line can still be watched."""
        with suppress(StoreError):
            await self._database.write(work)

    def _refuse_too_many(self, name: str, address: str, panel: bool) -> None:
        if not self._failures.too_many(name, address, self._clock(), panel=panel):
            return
        problem = Problem(429, "too_many", "too many sign-ins failed; try again in five minutes")
        raise problem.with_headers(Retry_After=RETRY_AFTER_S)

    async def _failed(self, name: str, address: str) -> None:
        self._failures.note(name, address, self._clock())
        known = await self._database.read(lambda connection: store.user(connection, name))
        # A password typed into the field for the name must not end up in the log.
        who = name if known else "unknown name"
        await self._events.record(kind="login_refused", what="sign-in refused", who=who, origin=address)


def _expired(name: str, expired_at: float) -> Problem:
    """Only who holds the token learns this, so it tells nothing to a stranger."""
    day = datetime.fromtimestamp(expired_at, UTC).date().isoformat()
    problem = Problem(
        401,
        "unauthorized",
        "the token {called} expired on {day}; an admin can create a new one",
        params={"called": name, "day": day},
    )
    # RFC 6750, 3.1
    return problem.with_headers(
        WWW_Authenticate='Bearer error="invalid_token", error_description="The access token expired"'
    )


def _lifetime(user: User) -> rules.Lifetime:
    return rules.PANEL_LIFETIME if user.panel else rules.PERSON_LIFETIME
