"""What connections of HTTP and of WebSockets have in common: they are counted, parsed in turn, and watched to
their end."""

from __future__ import annotations

from typing import Any

from app.server.addresses import source_of
from app.server.connections import Connection, Connections
from app.server.intake import InputInTurn
from app.server.pace import Backlog
from app.server.refusal_log import RefusalLog

CLOSING_S = 5.0
"""What a client gets to read the end of a connection."""


class CountedProtocol(InputInTurn):
    """To be inherited before a protocol of uvicorn; ``connection`` is set before anything is received."""

    connection: Connection

    def __init__(
        self, *args: Any, open_connections: Connections, refusals: RefusalLog, **options: Any
    ) -> None:
        super().__init__(*args, **options)
        self._open_connections = open_connections
        self._refusals = refusals
        self._backlog = Backlog()
        self._closing_since: float | None = None

    def connection_lost(self, exc: Exception | None) -> None:
        self._open_connections.close(self.connection)
        self.connection.holder = None
        super().connection_lost(exc)

    def resume_writing(self) -> None:
        self._backlog = Backlog()
        super().resume_writing()

    def _is_at_its_end(self, now: float) -> bool:
        """Whether the connection is being closed, which is cut short where it takes too long."""
        if not self.transport.is_closing() and self._closing_since is None:
            return False
        self._closing_since = self._closing_since or now
        if now - self._closing_since > CLOSING_S:
            self.transport.abort()
        return True

    def _turn_key(self) -> str:
        """The account, or the address of a stranger: one with many connections has no more turns."""
        return self.connection.account or source_of(self.connection.address)

    def _identify(self, account: str) -> None:
        self._open_connections.identify(self.connection, account)
