"""Two servers of one site in this process, at real sockets. ``dry-end`` is at the second, whose units
respond.

Each has a copy of one store, with the same users, tokens, sessions and secret; a test decides the homes.
What is shared by the store itself is tested over PostgreSQL.
"""

from __future__ import annotations

import asyncio
import shutil
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from app.cli.serving.server import Server
from app.database import Database
from app.feature import Services
from app.routing.peers import Peers
from app.routing.site_servers import SiteServers
from app.settings import Settings
from app.web.admission.access import Role
from bus.instants import monotonic_now, unix_now
from tests.app.complete_app import EVERY_ROLE, complete_app, settings_in
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.app.played_site import PlayedHomes

FIRST, SECOND = "app-1", "app-2"


@dataclass
class ServedApp:
    """One of the servers."""

    services: Services
    homes: PlayedHomes
    url: str
    server: Server

    @property
    def servers(self) -> SiteServers:
        return self.services[SiteServers]


@dataclass
class TwoServers:
    """``tokens`` and ``cookies``: by role, good at both."""

    first: ServedApp
    second: ServedApp
    line: PlayedLine
    tokens: dict[Role, str]
    cookies: dict[Role, dict[str, str]]
    clients: list[httpx.AsyncClient] = field(default_factory=list)

    def credential(self, role: Role | None) -> dict[str, str]:
        """The header of a token."""
        return {} if role is None else {"Authorization": f"Bearer {self.tokens[role]}"}

    def client(
        self, at: ServedApp | None = None, headers: Mapping[str, str] | None = None
    ) -> httpx.AsyncClient:
        """A client of a server, of the first where none is given."""
        client = httpx.AsyncClient(base_url=(at or self.first).url, headers=headers, timeout=20)
        self.clients.append(client)
        return client

    def program(self, role: Role, at: ServedApp | None = None) -> httpx.AsyncClient:
        """A program with a token."""
        return self.client(at, self.credential(role))

    def browser(self, role: Role, at: ServedApp | None = None) -> httpx.AsyncClient:
        """A browser that has signed in."""
        client = self.client(at, {"Accept": "text/html"})
        client.cookies.update(self.cookies[role])
        return client

    def move(self, server: str, url: str) -> None:
        """Make a server the home of the bus."""
        for each in (self.first, self.second):
            each.homes.put(BUS, server, url)


@asynccontextmanager
async def two_servers(folder: Path, **site: Any) -> AsyncIterator[TwoServers]:
    """From start to end."""
    origin, copied = folder / "one", folder / "two"
    settings, tokens, cookies = settings_in(origin, **site), {}, {}
    async with complete_app(origin, **site) as house:
        for role in EVERY_ROLE:
            tokens[role] = await house.token(role)
            if role is not Role.WORKER:
                client = await house.signed_in(role)
                cookies[role] = dict(client.cookies)
        servers, database = house.services[SiteServers], house.services[Database]
        await servers.load(database)
    shutil.copytree(origin, copied)
    async with _served(settings, FIRST) as first, _served(settings_in(copied, **site), SECOND) as second:
        line = await played_line(second.services)
        site_of_two = TwoServers(first, second, line, tokens, cookies)
        site_of_two.move(SECOND, second.url)
        try:
            yield site_of_two
        finally:
            for client in site_of_two.clients:
                await client.aclose()


@asynccontextmanager
async def _served(settings: Settings, name: str) -> AsyncIterator[ServedApp]:
    serving, homes = asyncio.Event(), PlayedHomes(name)
    listening = socket.create_server(("127.0.0.1", 0))
    port = listening.getsockname()[1]
    server = Server(settings, demo=False, worker_tokens={}, serving=lambda _code: serving.set())
    servers = server.services[SiteServers]
    servers.homes = homes
    task = asyncio.create_task(server.serve([listening]))
    await asyncio.wait({task, asyncio.create_task(serving.wait())}, return_when=asyncio.FIRST_COMPLETED)
    await servers.load(server.services[Database])
    now = monotonic_now()
    servers.clock.compare(now, unix_now(), now)
    ticking = asyncio.create_task(servers.compare_clocks(_now))
    try:
        yield ServedApp(server.services, homes, f"http://127.0.0.1:{port}", server)
    finally:
        ticking.cancel()
        await server.services[Peers].close()
        server.end()
        await task


async def _now() -> Any:
    return unix_now()
