"""The app in this process, complete or up to the commands, with its stores in a folder, its users and its
workers.

``complete_app`` has two units, which `tests.app.played_line` lets respond. ``commands_app`` has the features
up to the commands, three units, a worker that the test plays (`tests.app.fake_worker`), and any people.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import asynccontextmanager, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from fastapi import FastAPI

import app.core.database.database
import app.main
from app.core.database import Database
from app.core.web.access import PEOPLE_ROLES, SESSION, Role
from app.feature import Feature, Services
from app.line.commands import feature as commands
from app.line.commands.record import CommandRecord
from app.line.commands.safeguards import Safeguards
from app.line.commands.service import CommandService
from app.line.feed.bus_feed import BusFeed, HeldSpeeds
from app.line.feed.channel import Channel
from app.line.history.service import History
from app.line.live.bus_live import BusLive
from app.line.live.change_recorder import ChangeRecorder
from app.line.pipeline import Pipeline
from app.people.audit.log import EventLog
from app.people.auth import rules, store
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from app.people.auth.settings import OidcSettings
from app.people.auth.store import Token, User
from app.records.handover.rules import ShiftSettings
from app.records.notification.settings import NotifySettings
from app.settings import ServerSettings, Settings, Site, load
from bus.contract import Hello, Snapshot, Welcome
from bus.settings import BusSettings, UnitLabels, UnitSettings
from tests.administrator import BY
from tests.app.fake_worker import BUS, PlayedWorker, bus_settings, hello, snapshot, until
from tests.app.played_rights import PlayedRights

UP_TO_COMMANDS = app.main.FEATURES[: app.main.FEATURES.index(commands.FEATURE) + 1]
OWN_WORKER = "own"
"""The name under which a worker is the child of the server."""
OWN_TOKEN = "token-of-the-child"
PASSWORD = "correct horse battery"
HOST = "plant.example"


def settings_in(folder: Path, **site: Any) -> Settings:
    """One bus of two units."""
    unwind = UnitSettings(id=1, name="Unwind", labels=UnitLabels(unit="m/min"))
    units = (unwind, UnitSettings(id=2, name="Nip"))
    bus = BusSettings(name="dry-end", port="/dev/null", unit=units)
    return Settings(
        site=Site(**{"name": "Mill 7", **site}), server=ServerSettings(data=folder / "data"), bus=(bus,)
    )


@dataclass
class House:
    """The app and its clients."""

    app: FastAPI
    services: Services
    clients: list[httpx.AsyncClient] = field(default_factory=list)
    address: str = "192.0.2.7"
    rights: PlayedRights = field(default_factory=PlayedRights)
    """What `commands_app` permits: everything that a test does not withdraw."""
    _browsers: dict[str, tuple[str, httpx.AsyncClient]] = field(default_factory=dict)
    _tokens: list[str] = field(default_factory=list)
    _keys: dict[Role, str] = field(default_factory=dict)
    _workers: list[PlayedWorker] = field(default_factory=list)

    def client(self, **headers: str) -> httpx.AsyncClient:
        """Return a browser-like client; cookies are kept, redirects are not followed."""
        transport = httpx.ASGITransport(self.app, client=(self.address, 4711))
        client = httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}", headers=headers)
        self.clients.append(client)
        return client

    async def add(self, name: str, role: Role) -> None:
        """A person with the password of all, unless there is one, of an earlier case of the same test."""
        users = await self.services[Database].read(store.users)
        if not any((user.name, user.role) == (name, role) for user in users):
            await self.services[Accounts].add_user(name, role, PASSWORD, **BY)

    async def signed_in(self, role: Role, name: str = "") -> httpx.AsyncClient:
        """A new browser of a person who has signed in."""
        name = name or f"the-{role}"
        await self.add(name, role)
        client = self.client()
        response = await client.post("/login", data={"name": name, "password": PASSWORD})
        assert response.status_code == 303
        return client

    async def token(self, role: Role) -> str:
        """A bearer token."""
        name, tokens = f"key-{role}", await self.services[Database].read(store.tokens)
        if name not in {token.name for token in tokens}:
            bus = "dry-end" if role is Role.WORKER else ""
            self._keys[role] = await self.services[Accounts].create_token(name, role, bus=bus, **BY)
        return self._keys[role]

    async def program(self, role: Role) -> httpx.AsyncClient:
        """A program with a token."""
        return self.client(Authorization=f"Bearer {await self.token(role)}")

    async def events(self, kind: str) -> list[dict[str, Any]]:
        """Return the events of one kind, newest first."""
        from app.people.audit.log import Filter

        return (await self.services[EventLog].page(Filter(kind=kind), 100))[0]

    @property
    def log(self) -> EventLog:
        return self.services[EventLog]

    @property
    def live(self) -> BusLive:
        return self.services.buses[BUS][BusLive]

    @property
    def feed(self) -> BusFeed:
        return self.services.buses[BUS][BusFeed]

    @property
    def pipeline(self) -> Pipeline:
        return self.services.buses[BUS][Pipeline]

    @property
    def recorder(self) -> ChangeRecorder:
        return self.services.buses[BUS][ChangeRecorder]

    @property
    def guards(self) -> Safeguards:
        return self.services.buses[BUS][Safeguards]

    @property
    def commands(self) -> CommandService:
        return self.services.buses[BUS][CommandService]

    def commands_after_restart(self) -> CommandService:
        """Return the commands of a server that remembers nothing but what is on disk."""
        of_bus, record = self.services.buses[BUS], CommandRecord(self.log, self.services[Database], time.time)
        held = of_bus[HeldSpeeds]
        return CommandService(self.live, of_bus[Channel], record, self.guards, self.services[Rights], held)

    def http(self, role: str = "admin", name: str = "") -> httpx.AsyncClient:
        """Return a browser of a person, named as the role unless ``name`` is given, who has the role from now
        on. No event tells of them. Without a role: a stranger's browser."""
        if role in ("", Role.WORKER):
            return self.client(**self._bearer(role, role, BUS))
        name = name or role
        had, client = self._browsers.get(name, ("", None))
        if had == role and client is not None:
            return client

        def sign_in(connection: sqlite3.Connection) -> None:
            if client is None:
                now = time.time()
                store.add_user(connection, User(name, Role(role), False, "", "", False, now, None), "")
                secret = rules.secret_hash(name)
                store.begin_session(connection, secret, name, now, now + 3600, weak_secret=False)
            store.set_role(connection, name, Role(role))

        self._write(sign_in)
        client = client or self.client(Cookie=f"{SESSION}={name}")
        self._browsers[name] = role, client
        return client

    async def request(
        self, method: str, path: str, body: Any = None, role: str = "admin", name: str = "", **more: Any
    ) -> httpx.Response:
        """Call the API on the bus."""
        url = f"/api/v1/buses/{BUS}{path}"
        return await self.http(role, name).request(method, url, json=body, **more)

    async def connect(self, role: str = "worker", bus: str = BUS, name: str = "") -> PlayedWorker:
        """Connect to /feed by the token ``name`` for ``bus``, and send nothing. Raises HandshakeRefused."""
        worker = PlayedWorker(self.app, {"Host": HOST, **self._bearer(role, name or role, bus)})
        self._workers.append(worker)
        await worker.open()
        return worker

    async def worker(
        self, first: Hello | None = None, state: Snapshot | None = None, name: str = ""
    ) -> PlayedWorker:
        """Connect a worker, and send hello and ``state``, or that of three units that respond."""
        worker = await self.connect(name=name)
        await worker.send(first or hello())
        welcome = await worker.receive(Welcome)
        assert isinstance(welcome, Welcome)
        assert welcome.refused == ""
        present = state or snapshot()
        worker.seq = present.seq
        await worker.send(present)
        await until(lambda: self.live.worker_connected, "the snapshot taken in")
        await until(lambda: self.services.buses[BUS][Channel].connected, "the way down open")
        return worker

    def _bearer(self, role: str, name: str, bus: str) -> dict[str, str]:
        if not role:
            return {}
        secret = OWN_TOKEN if name == OWN_WORKER else f"{name} {bus} {role}"
        if secret not in (OWN_TOKEN, *self._tokens):
            token = Token(0, name, Role(role), "test", time.time(), None, bus)
            self._write(lambda connection: store.add_token(connection, rules.secret_hash(secret), token))
            self._tokens.append(secret)
        return {"Authorization": f"Bearer {secret}"}

    def _write(self, work: Callable[[sqlite3.Connection], None]) -> None:
        """Change the store beside the app, as the command line does."""
        with closing(sqlite3.connect(self.services[Database].path, timeout=60)) as connection, connection:
            connection.execute("PRAGMA synchronous = OFF")
            work(connection)

    async def close(self) -> None:
        """End the clients and the workers."""
        for worker in self._workers:
            await worker.end()
        for client in self.clients:
            await client.aclose()


class AtOnce:
    """An executor without threads: each work is done where it is given. A fifth of what an app and its calls
    take goes to hand their short work to threads and back; the servers that tests start have threads."""

    def __init__(self, *_: object, **__: object) -> None:
        self._is_shut_down = False

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Do it, and return its result. Raises RuntimeError after the end, as an executor does."""
        if self._is_shut_down:
            raise RuntimeError("the executor was shut down")
        result: Future[Any] = Future()
        try:
            result.set_result(work(*arguments))
        except Exception as error:
            result.set_exception(error)
        return result

    def shutdown(self) -> None:
        """Take no more work."""
        self._is_shut_down = True


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
    bus: BusSettings | None = None,
    features: Sequence[Feature] = app.main.FEATURES,
    **site: Any,
) -> AsyncIterator[House]:
    """Run the app from start to end, as the server would; ``config``: with this file."""
    settings = settings_in(folder, **site) if config is None else load(config)
    others: dict[str, Any] = {"server": server or settings.server, "notify": notify or settings.notify}
    others |= {"shift": shift or settings.shift, "oidc": oidc or settings.oidc}
    others |= {"bus": settings.bus if bus is None else (bus,)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app.main, "FEATURES", features)
        patch.setattr(app.core.database.database, "ThreadPoolExecutor", AtOnce)
        tokens = {BUS: OWN_TOKEN}
        made = app.main.create_app(settings.model_copy(update=others), demo=demo, worker_tokens=tokens)
    house = House(made, made.state.services)
    async with house.services.lifespan.running():
        try:
            yield house
        finally:
            await house.close()


async def _nothing_newest(*_: object) -> None:
    """As of a history that stores nothing."""


@asynccontextmanager
async def commands_app(folder: Path, *, control: bool = False) -> AsyncIterator[House]:
    """Run the features up to the commands, with three units. Any person may do what their role allows,
    also without an account; a worker may be silent for as long as a test takes; history stores nothing."""
    with pytest.MonkeyPatch.context() as patch:
        # Opening its store is a third of what such an app costs.
        for name in ("start", "append", "close"):
            patch.setattr(History, name, lambda *_: None)
        patch.setattr(History, "newest", _nothing_newest)
        options: dict[str, Any] = {"bus": bus_settings(), "features": UP_TO_COMMANDS, "control": control}
        async with complete_app(folder, **options) as house:
            house.services[Rights].check = house.rights.check  # type: ignore[method-assign]
            house.feed.timeout_ticks = 1000
            yield house


EVERY_ROLE = (*PEOPLE_ROLES, Role.WORKER)


@dataclass
class Api:
    """A served app and the token of an engineer."""

    url: str
    token: str

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}


@contextmanager
def served(folder: Path) -> Iterator[Api]:
    """Serve until the end of the context."""
    made = app.main.create_app(settings_in(folder))
    services: Services = made.state.services
    token = rules.new_secret()
    key = Token(0, "test", Role.ENGINEER, "test", 0.0, None)
    services[Database].write_now(lambda c: store.add_token(c, rules.secret_hash(token), key))
    server = uvicorn.Server(
        uvicorn.Config(made, port=0, log_level="warning", lifespan="on", ws="websockets-sansio")
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        thread.join(0.02)
        assert thread.is_alive(), "the server did not start"
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield Api(f"http://127.0.0.1:{port}", token)
    finally:
        server.should_exit = True
        thread.join()
