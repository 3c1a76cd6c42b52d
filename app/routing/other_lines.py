"""What the other homes know, for responses of this server about all lines."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
from starlette.requests import HTTPConnection

from app.home.lease import SITE
from app.routing.forwarding.headers import to_home
from app.routing.forwarding.hop import HEADER
from app.routing.peers import Peers
from app.routing.site_servers import SiteServers, target_of
from app.web.admission.security import PASSED_ON

MAX_S = 1.0
MAX_BYTES = 4 * 1024 * 1024
"""A bus of 255 units takes 0.5 MB."""


class HomeResponse(NamedTuple):
    """What a home responded; ``places``: the buses whose home it is, and the site (``""``)."""

    places: frozenset[str]
    body: dict[str, Any]


@dataclass(frozen=True, eq=False, repr=False)
class OtherLines:
    """Repeats a request with the credentials of the person, whose role each home checks."""

    _servers: SiteServers
    _peers: Peers

    async def responses(self, connection: HTTPConnection) -> list[HomeResponse]:
        """The JSON that each other home has for this request; without those of a home that does not
        respond within a second, and none where another server repeats its own request."""
        servers = self._servers
        if not servers.is_shared or PASSED_ON in connection.scope or not servers.is_clock_known:
            return []
        places: dict[str, set[str]] = {}
        for place in (SITE, *servers.buses):
            if servers.is_elsewhere(place):
                places.setdefault(servers.homes.of(place).url, set()).add(place)
        found = await asyncio.gather(*(self._of_server(connection, url) for url in places))
        return [
            HomeResponse(frozenset(places[url]), body)
            for url, body in zip(places, found, strict=True)
            if body is not None
        ]

    async def _of_server(self, connection: HTTPConnection, url: str) -> dict[str, Any] | None:
        import httpx

        target = target_of(connection.scope)
        headers = to_home(connection.scope["headers"])
        headers.append((HEADER.encode(), self._servers.seal(connection.scope, target).encode()))
        try:
            async with asyncio.timeout(MAX_S):
                return await self._requested(url, target, headers)
        except (httpx.HTTPError, TimeoutError, ValueError):
            return None

    async def _requested(
        self, url: str, target: bytes, headers: list[tuple[bytes, bytes]]
    ) -> dict[str, Any] | None:
        headers = [*headers, (b"accept-encoding", b"identity")]
        reading = self._peers.reading
        async with reading.stream("GET", url, headers=headers, extensions={"target": target}) as response:
            body = b""
            async for piece in response.aiter_raw():
                body += piece
                if len(body) > MAX_BYTES:
                    return None
            if not response.is_success:
                return None
        return msgspec.json.decode(body, type=dict[str, Any])
