"""Connections to the other servers of the site."""

from __future__ import annotations

import ssl
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import httpx

CONNECT_S = 0.7
"""To reach a home; a page waits no longer for one that is off."""
PIECE_S = 30.0
"""From one piece of a response to the next; a stream has one every 5 s."""
MAX_IDLE_S = 2.0
"""A connection is used again within this time, which is less than a server keeps it open."""
MAX_CONNECTIONS = 400


class Peers:
    """``authority``: a file of the authority that signs the servers' certificates, beside those of this
    machine."""

    def __init__(self, authority: Path | None = None) -> None:
        self._authority = authority

    @cached_property
    def context(self) -> ssl.SSLContext:
        """What verifies the certificate of another server. Raises OSError for a file that holds none."""
        context = ssl.create_default_context()
        if self._authority is not None:
            context.load_verify_locations(cafile=self._authority)
        return context

    @cached_property
    def reading(self) -> httpx.AsyncClient:
        """For requests that change nothing: connections are used again."""
        return self._client(keep=50)

    @cached_property
    def writing(self) -> httpx.AsyncClient:
        """For the others: a connection each. On one that is used again a request may be lost without a
        sign, and it would not be known whether a command was sent."""
        return self._client(keep=0)

    async def close(self) -> None:
        """End the connections that are kept."""
        for name in ("reading", "writing"):
            if name in self.__dict__:
                await self.__dict__[name].aclose()

    def _client(self, keep: int) -> httpx.AsyncClient:
        import httpx  # a tenth of a second of the start

        return httpx.AsyncClient(
            verify=self.context,
            trust_env=False,  # a proxy of the environment leads out of the plant
            follow_redirects=False,
            timeout=httpx.Timeout(PIECE_S, connect=CONNECT_S, pool=CONNECT_S),
            limits=httpx.Limits(
                max_connections=MAX_CONNECTIONS, max_keepalive_connections=keep, keepalive_expiry=MAX_IDLE_S
            ),
        )
