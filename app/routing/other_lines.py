"""The buses of other homes, for ``GET /line`` of this server."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
from starlette.requests import HTTPConnection

from app.routing.headers import to_home
from app.routing.hop import HEADER
from app.routing.peers import Peers
from app.routing.site_servers import SiteServers
from app.web.security import PASSED_ON

PATH = "/api/v1/line"
MAX_S = 1.0
MAX_BYTES = 4 * 1024 * 1024
"""A bus of 255 units takes 0.5 MB."""


@dataclass(frozen=True, eq=False, repr=False)
class OtherLines:
    """Requests them with the credentials of the person, whose role each home checks."""

    _servers: SiteServers
    _peers: Peers

    async def buses(self, connection: HTTPConnection) -> Mapping[str, dict[str, Any]]:
        """The buses whose home is another server, by name, as that shows them; without those of a home
        that does not respond within a second."""
        servers = self._servers
        if not servers.is_shared or PASSED_ON in connection.scope or not servers.is_clock_known:
            return {}
        urls: dict[str, set[str]] = {}
        for bus in servers.buses:
            if servers.is_elsewhere(bus):
                urls.setdefault(servers.homes.of(bus).url, set()).add(bus)
        found = await asyncio.gather(*(self._of_server(connection, url, urls[url]) for url in urls))
        return {name: bus for buses in found for name, bus in buses.items()}

    async def _of_server(
        self, connection: HTTPConnection, url: str, buses: set[str]
    ) -> Mapping[str, dict[str, Any]]:
        import httpx

        headers = to_home(connection.scope["headers"])
        headers.append((HEADER.encode(), self._servers.seal(connection.scope, PATH.encode()).encode()))
        try:
            async with asyncio.timeout(MAX_S):
                return await self._requested(f"{url.rstrip('/')}{PATH}", headers, buses)
        except (httpx.HTTPError, TimeoutError, ValueError, TypeError, KeyError, AttributeError):
            return {}

    async def _requested(
        self, url: str, headers: list[tuple[bytes, bytes]], buses: set[str]
    ) -> Mapping[str, dict[str, Any]]:
        headers = [*headers, (b"accept-encoding", b"identity")]
        async with self._peers.reading.stream("GET", url, headers=headers) as response:
            body = b""
            async for piece in response.aiter_raw():
                body += piece
                if len(body) > MAX_BYTES:
                    return {}
            if not response.is_success:
                return {}
        return {bus["name"]: bus for bus in msgspec.json.decode(body)["buses"] if bus["name"] in buses}
