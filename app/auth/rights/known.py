"""Sessions and tokens as the database had them a second ago: they hold while it is away.

A right that was withdrawn before, on any server, is withdrawn here too.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

from app.auth import store
from app.auth.store import Session, Token
from app.database import Database, StoreConnection
from app.errors import StoreError

REFRESH_S = 1.0
MAX_KNOWN = 5000
"""Sessions, those that were used last."""
_Known = tuple[dict[bytes, Session], dict[bytes, Token]]


class KnownCredentials:
    """Of a site whose database may be away. By the hash of each secret."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._sessions: dict[bytes, Session] = {}
        self._tokens: dict[bytes, Token] = {}

    async def watch(self) -> None:
        """Run until canceled: read them each second."""
        while True:
            with suppress(StoreError):
                self._sessions, self._tokens = await self._database.read(_read)
            await asyncio.sleep(REFRESH_S)

    def session(self, hash_: bytes) -> Session | None:
        """The session of a cookie; None where it was not there, or has ended here since."""
        return self._sessions.get(hash_)

    def token(self, hash_: bytes) -> Token | None:
        """The token with this hash; None where it was not there."""
        return self._tokens.get(hash_)

    def note_session(self, hash_: bytes, session: Session | None) -> None:
        """The session of a cookie has just been read; None: there is none."""
        if session is None:
            self._sessions.pop(hash_, None)
        else:
            self._sessions[hash_] = session

    def is_signed_in(self, name: str) -> bool:
        """Whether a user has a session."""
        return any(session.user.name == name for session in self._sessions.values())


def _read(connection: StoreConnection) -> _Known:
    return store.sessions(connection, MAX_KNOWN), store.tokens_by_hash(connection)
