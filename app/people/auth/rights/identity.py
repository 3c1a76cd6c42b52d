"""The account of a session cookie or a bearer token."""

from __future__ import annotations

import hmac
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from app.core.database import Database, StoreConnection
from app.core.web.admission.access import Caller, Role, account_of
from app.errors import Problem, StoreError
from app.people.auth import rules, store
from app.people.auth.sign_in.signin import SignIn
from app.people.auth.store import Token
from bus.instants import Clock, unix_now
from bus.messages import Message


@dataclass(eq=False, repr=False)
class Identity:
    """``worker_tokens``: by bus, of the workers that this server starts itself; they end with the server."""

    _database: Database
    _sign_in: SignIn
    _worker_tokens: Mapping[str, str]
    _clock: Clock = unix_now

    async def by_cookie(self, cookie: str, *, is_use: bool = True) -> Caller | None:
        """The account of a session cookie; None when it is over or was never valid.

        ``is_use`` False: the lookup prolongs nothing.
        """
        hash_ = rules.secret_hash(cookie)
        session = await self._database.read(lambda connection: store.session(connection, hash_))
        now = self._clock()
        if session is None or session.user.disabled or session.user.is_refused_panel:
            return None
        lifetime = self._sign_in.lifetime_of(session.user)
        if min(session.expires_at, lifetime.ends_at(session.created_at, session.used_at)) <= now:
            await self._sign_in.end(hash_)
            return None
        if is_use and now - session.used_at >= rules.USE_NOTED_EVERY_S:
            ends = lifetime.ends_at(session.created_at, now)
            await self._note(lambda connection: store.prolong_session(connection, hash_, now, ends))
        user = session.user
        return Caller(
            user.name,
            user.role,
            "session",
            user.language,
            user.panel,
            user.home,
            user.created_at,
            has_company_account=user.company_account is not None,
            credential=user.credential,
        )

    async def by_token(self, bearer: str) -> Caller | None:
        """The account of a bearer token. Raises ExpiredTokenError for one that has."""
        for bus, own in self._worker_tokens.items():
            if hmac.compare_digest(bearer.encode(), own.encode()):
                return Caller("worker", Role.WORKER, "worker", bus=bus)
        hash_ = rules.secret_hash(bearer)
        token = await self._database.read(lambda connection: store.token(connection, hash_))
        if token is None:
            return None
        now = self._clock()
        if not token.is_good(now):
            raise ExpiredTokenError(token)
        if token.used_at is None or now - token.used_at > rules.USE_NOTED_EVERY_S:
            number = token.id
            await self._note(lambda connection: store.note_token_used(connection, number, now))
        return Caller(
            token.name,
            token.role,
            "token",
            created_at=token.created_at,
            bus=token.bus or "",
            credential=token.credential,
        )

    async def _note(self, work: Callable[[StoreConnection], None]) -> None:
        """Store when an account was last used. On a full disk the line can still be watched."""
        with suppress(StoreError):
            await self._database.write(work)


class ExpiredTokenError(Problem):
    """401 for the holder of an expired token; a stranger does not get it. ``account``: the token's."""

    def __init__(self, token: Token) -> None:
        expired = Message.of("token_expired", called=token.name, day=token.last_day)
        super().__init__(401, "unauthorized", expired)
        self.account = account_of(token.name, token=True)
        # RFC 6750, 3.1
        self.with_headers(
            WWW_Authenticate='Bearer error="invalid_token", error_description="The access token expired"'
        )
