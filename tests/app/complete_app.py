"""The complete app in this process, with its stores in a folder, and users of each role."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
from fastapi import FastAPI

from app.core.web.access import PEOPLE_ROLES, Role
from app.feature import Services
from app.main import create_app
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from app.people.auth.settings import OidcSettings
from app.records.handover.settings import ShiftSettings
from app.records.notification.settings import NotifySettings
from app.settings import ServerSettings, Settings, Site, load
from bus.settings import BusSettings, UnitLabels, UnitSettings
from tests.administrator import BY

PASSWORD = "correct horse battery"
HOST = "plant.example"


def settings_in(folder: Path, **site: Any) -> Settings:
    """One bus of two units."""
    unwind = UnitSettings(id=1, name="Unwind", labels=UnitLabels(unit="m/min"))
    units = (unwind, UnitSettings(id=2, name="Nip"))
    bus = BusSettings(name="dry-end", port="/dev/null", unit=units)
    return Settings(
        site=Site(**{"name": "Mill 7", **site}),
        server=ServerSettings(data=folder / "data"),
        bus=(bus,),
    )


@dataclass
class House:
    """The app and its clients."""

    app: FastAPI
    services: Services
    clients: list[httpx.AsyncClient] = field(default_factory=list)
    address: str = "192.0.2.7"

    def client(self, **headers: str) -> httpx.AsyncClient:
        """Return a browser-like client; cookies are kept, redirects are not followed."""
        transport = httpx.ASGITransport(self.app, client=(self.address, 4711))
        client = httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}", headers=headers)
        self.clients.append(client)
        return client

    async def add(self, name: str, role: Role) -> None:
        """A person with the password of all."""
        await self.services[Accounts].add_user(name, role, PASSWORD, **BY)

    async def signed_in(self, role: Role, name: str = "") -> httpx.AsyncClient:
        """A browser of a new person who has signed in."""
        name = name or f"the-{role}"
        await self.add(name, role)
        client = self.client()
        response = await client.post("/login", data={"name": name, "password": PASSWORD})
        assert response.status_code == 303
        return client

    async def token(self, role: Role) -> str:
        """A bearer token."""
        bus = "dry-end" if role is Role.WORKER else ""
        return await self.services[Accounts].create_token(f"key-{role}", role, bus=bus, **BY)

    async def program(self, role: Role) -> httpx.AsyncClient:
        """A program with a token."""
        return self.client(Authorization=f"Bearer {await self.token(role)}")

    async def events(self, kind: str) -> list[dict[str, Any]]:
        """Return the events of one kind, newest first."""
        from app.people.audit.queries import Filter

        return (await self.services[EventLog].page(Filter(kind=kind), 100))[0]


@asynccontextmanager
async def complete_app(
    folder: Path,
    *,
    demo: bool = False,
    server: ServerSettings | None = None,
    notify: NotifySettings | None = None,
    shift: ShiftSettings | None = None,
    oidc: OidcSettings | None = None,
    config: Path | None = None,
    **site: Any,
) -> AsyncIterator[House]:
    """From start to end, as the server would; ``config``: with this file."""
    settings = settings_in(folder, **site) if config is None else load(config)
    others: dict[str, Any] = {"server": server or settings.server, "notify": notify or settings.notify}
    others |= {"shift": shift or settings.shift, "oidc": oidc or settings.oidc}
    app = create_app(settings.model_copy(update=others), demo=demo)
    house = House(app, app.state.services)
    async with house.services.lifespan.running():
        try:
            yield house
        finally:
            for client in house.clients:
                await client.aclose()


EVERY_ROLE = (*PEOPLE_ROLES, Role.WORKER)
