"""The live and command part of the app with a worker that is played: real HTTP, real WebSocket, real store.

The person of a request is named by its role in the header ``X-Role``.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from copy import copy
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Receive, Scope, Send
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from app.core.database import Database
from app.core.web.access import Person, Role, Via
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.problems import install
from app.core.web.routes import Turns, guard
from app.core.web.services import Registry
from app.core.web.templating import Templates
from app.line.commands.api.commands import router as commands_router
from app.line.commands.api.safeguards import router as safeguards_router
from app.line.commands.api.trace import router as trace_router
from app.line.commands.record import CommandRecord
from app.line.commands.safeguards import Safeguards
from app.line.commands.service import CommandService
from app.line.feed.bus_feed import BusFeed
from app.line.feed.channel import Channel
from app.line.feed.socket import Workers
from app.line.feed.socket import router as feed_router
from app.line.history.status import HistoryStatus
from app.line.live.api.routes import router as live_router
from app.line.live.api.view import LineView
from app.line.live.bus_live import LiveState
from app.line.live.change_recorder import ChangeRecorder
from app.line.live.sources import Sources
from app.line.pipeline import Pipeline
from app.people.audit.acts import ActLimit
from app.people.audit.api import router as events_router
from app.people.audit.log import EventLog
from app.settings import Settings, Site
from bus.contract import (
    CONTRACT_VERSION,
    AppMessage,
    Batch,
    BusLink,
    Command,
    Hello,
    ParameterValue,
    Reading,
    Result,
    Snapshot,
    UnitLink,
    UnitState,
    Update,
    Welcome,
    WorkerMessage,
    decode_from_app,
    encode,
)
from bus.messages import term
from bus.settings import BusSettings, UnitSettings
from tests.app.played_rights import PlayedRights
from tests.app.played_sources import NoGoldenSets
from tests.app.screens import translator

REMOTE, HEALTHY = 0b0100_0000, 0b0000_0010
PARAMETERS = {1: 1750, 2: 20000, 3: 1, 8: 0, 22: 0, 23: 500, 28: 2, 29: 100, 30: 2000, 12: 20}
OWN_WORKER = "own"
"""The name under which a worker of the stage is the child of the server."""
Play = Callable[[Command], Awaitable[Sequence[Update]]]


def bus_settings(**changes: Any) -> BusSettings:
    """Three units on one bus."""
    units = tuple(UnitSettings(id=number, name=f"Unit {number}") for number in (1, 2, 16))
    return BusSettings(**{"name": "dry-end", "port": "/dev/null", "unit": units, **changes})


def reading(unit: int, commanded: int = 1000, **changes: Any) -> Reading:
    """Return a new response to 81h."""
    fields: dict[str, Any] = {"actual": commanded, "analog": 51, "outputs": REMOTE, "inputs": HEALTHY}
    return Reading(unit=unit, at=time.time(), commanded=commanded, **{**fields, **changes})


def unit_state(unit: int, parameters: dict[int, int] | None = None) -> UnitState:
    """Return a unit that responds, with the parameters that a page needs."""
    now = time.time()
    known = PARAMETERS if parameters is None else parameters
    values = [ParameterValue(unit=unit, number=number, at=now, raw=raw) for number, raw in known.items()]
    return UnitState(unit, UnitLink(unit=unit, at=now, link="online"), reading(unit), values)


def snapshot(seq: int = 0, units: Sequence[UnitState] | None = None, link: str = "open") -> Snapshot:
    """Return the complete state of the three units."""
    now = time.time()
    states = [unit_state(number) for number in (1, 2, 16)] if units is None else list(units)
    port = BusLink(
        at=now, link="open" if link == "open" else "closed", cause=None if link == "open" else term("gone")
    )
    # Of one clock, as every worker on this machine states it, however late a message is.
    return Snapshot(seq=seq, sent_at=now, bus=port, units=states, app_behind_s=0.0)


def hello(worker: str = "w1", bus: str = "dry-end", version: int = CONTRACT_VERSION) -> Hello:
    """The first word."""
    now = time.time()
    return Hello(version, bus, worker, now, "test", "/dev/null", now)


class History:
    """Remembers what it was given."""

    def __init__(self) -> None:
        self.updates: list[Update] = []
        self.status = HistoryStatus()

    def append(self, bus: str, updates: Sequence[Update]) -> None:
        """As the real one."""
        assert bus
        self.updates += updates

    @property
    def readings(self) -> list[Reading]:
        """The readings among them."""
        return [update for update in self.updates if isinstance(update, Reading)]


class PlayedWorker:
    """A worker that the test controls. ``play`` responds to commands; ``received`` has the app's messages."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.seq = 0
        self.received: list[AppMessage] = []
        self.commands: list[Command] = []
        self.play: Play | None = None
        self.closed: ConnectionClosed | None = None
        self._listening = asyncio.create_task(self._listen())

    async def send(self, message: WorkerMessage) -> None:
        """One message."""
        await self._socket.send(encode(message))

    async def send_raw(self, data: bytes | str) -> None:
        """Anything at all."""
        await self._socket.send(data)

    async def update(self, *updates: Update) -> None:
        """The next batch."""
        self.seq += 1
        await self.send(Batch(self.seq, time.time(), list(updates), app_behind_s=0.0))

    async def receive(self, kind: type[AppMessage], count: int = 1) -> AppMessage:
        """Wait for ``count`` messages of this kind; return the last one."""
        await until(lambda: len(self._of(kind)) >= count, f"{count} times {kind.__name__}")
        return self._of(kind)[count - 1]

    async def gone(self) -> ConnectionClosed:
        """Wait until the app ended the connection."""
        await until(lambda: self.closed is not None, "the end of the connection")
        assert self.closed is not None
        return self.closed

    async def leave(self, code: int = 1000) -> None:
        """End the connection."""
        await self._socket.close(code)
        await self._listening

    def _of(self, kind: type[AppMessage]) -> list[AppMessage]:
        return [message for message in self.received if isinstance(message, kind)]

    async def _listen(self) -> None:
        try:
            while True:
                data = await self._socket.recv()
                assert isinstance(data, bytes)
                await self._take(decode_from_app(data))
        except ConnectionClosed as closed:
            self.closed = closed

    async def _take(self, message: AppMessage) -> None:
        self.received.append(message)
        if isinstance(message, Command):
            self.commands.append(message)
            if self.play is not None:
                await self.update(*await self.play(message))


PEOPLE = {"anna": Role.OPERATOR, "ben": Role.OPERATOR, "vera": Role.VIEWER}


async def find(name: str) -> tuple[str, Role] | None:
    """The people of the stage, who are no tokens, and what they may do."""
    return (name, PEOPLE[name]) if name in PEOPLE else None


@cache
def _templates() -> Templates:
    return Templates(templates_dir(), Assets(static_dir()), Site())


class Stage:
    """Everything between the browser and the worker. ``http`` sends requests as a role."""

    def __init__(
        self,
        folder: Path,
        settings: BusSettings,
        *,
        control: bool = False,
        missed_ticks: int = 1000,
    ) -> None:
        self.database: Database = Database(folder / "lineside.db")
        self.events = EventLog(self.database)
        self.live = LiveState([settings], time.time())
        self.history = History()
        self.skipped_s = 0.0
        """By how much the clock of the leases is ahead of the real one."""
        self.command_clock_ahead_s = 0.0
        """The same of the clock by which commands count what was moved within a minute."""
        bus = self.live.buses[settings.name]
        self.recorder = ChangeRecorder(self.events, settings.name)
        self.pipeline = Pipeline(bus, self.history, self.recorder)
        self.channel = Channel()
        self.feed = BusFeed(
            self.channel,
            self.pipeline,
            monotonic=lambda: time.monotonic() + self.skipped_s,
            timeout_ticks=missed_ticks,
        )
        self.workers = Workers({settings.name: self.feed}, ChangeRecorder(self.events))
        self.rights = PlayedRights()
        self.guards = Safeguards(
            settings.name,
            bus.units,
            self.database,
            self.events,
            control_required=control,
            find=find,
            rights=self.rights,
        )
        self.commands = self.commands_after_restart()
        self.app = FastAPI()
        sources = Sources(
            {settings.name: self.guards},
            {settings.name: NoGoldenSets()},
            {settings.name: lambda: None},
            history_fault=lambda: self.history.status.message,
        )
        configuration = Settings(site=Site(name="Test line"), bus=(settings,))
        view = LineView(configuration.site.name, self.live, sources, translator())
        turns = Turns()
        self.app.state.services = Registry(
            (
                *(configuration, _templates(), view),
                *(self.live, self.workers, self.events, turns, ActLimit()),
            ),
            {settings.name: (bus, self.commands, self.guards)},
        )
        for router in (
            *(live_router, commands_router, safeguards_router),
            *(trace_router, feed_router, events_router),
        ):
            # As in `create_app`: rebuilding every route is most of the cost of a stage.
            self.app.router.routes.extend(copy(route) for route in router.routes)
        guard(self.app, turns)
        install(self.app)
        self.url = ""
        self._people: dict[str, httpx.AsyncClient] = {}

    def commands_after_restart(self) -> CommandService:
        """The commands of a server that remembers nothing but what is on disk."""
        (live,), record = self.live.buses.values(), CommandRecord(self.events, self.database, time.time)
        return CommandService(
            live,
            self.channel,
            record,
            self.guards,
            self.rights,
            lambda: time.monotonic() + self.command_clock_ahead_s,
        )

    def http(self, role: str = "admin", name: str = "") -> httpx.AsyncClient:
        """Return a client signed in as a user with this role."""
        key = f"{role}:{name or role}"
        if key not in self._people:
            self._people[key] = httpx.AsyncClient(
                base_url=f"http://{self.url}",
                headers={"X-Role": role, "X-Name": name or role},
                timeout=30,
                verify=False,  # Loading certificates takes longer than a call.
            )
        return self._people[key]

    async def request(
        self, method: str, path: str, body: Any = None, role: str = "admin", **more: Any
    ) -> httpx.Response:
        """One call of the API on the bus of the test."""
        url = f"/api/v1/buses/dry-end{path}"
        return await self.http(role, more.pop("name", "")).request(method, url, json=body, **more)

    async def worker(
        self, first: Hello | None = None, state: Snapshot | None = None, name: str = ""
    ) -> PlayedWorker:
        """Connect a worker and send hello and, unless ``state`` is given, the complete state."""
        played = await self.connect(name=name)
        await played.send(first or hello())
        welcome = await played.receive(Welcome)
        assert isinstance(welcome, Welcome)
        assert welcome.refused == ""
        present = state or snapshot()
        played.seq = present.seq
        before = self.live.buses["dry-end"].worker_connected
        await played.send(present)
        if not before:
            await until(lambda: self.live.buses["dry-end"].worker_connected, "the snapshot taken in")
        await until(lambda: self.channel.connected, "the way down open")
        return played

    async def connect(self, role: str = "worker", bus: str = "dry-end", name: str = "") -> PlayedWorker:
        """Connect to /feed by the token ``name`` of ``bus``, without sending anything."""
        headers = {"X-Role": role, "X-Bus": bus, "X-Name": name or role}
        return PlayedWorker(await connect(f"ws://{self.url}/feed", additional_headers=headers))

    async def close(self) -> None:
        """End the clients."""
        for client in self._people.values():
            await client.aclose()


class _ByHeader:
    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = dict(scope.get("headers", ()))
        role = headers.get(b"x-role", b"").decode()
        name = headers.get(b"x-name", role.encode()).decode()
        own = role == Role.WORKER and name == OWN_WORKER
        via: Via = "worker" if own else "token" if role == Role.WORKER else "session"
        bus = headers.get(b"x-bus", b"").decode()
        scope["caller"] = Person(name, Role(role), via, bus=bus) if role else None
        await self._app(scope, receive, send)


@asynccontextmanager
async def staged(
    folder: Path,
    *,
    control: bool = False,
    missed_ticks: int = 1000,
    **bus: Any,
) -> AsyncIterator[Stage]:
    """The stage, served on a free port."""
    stage = Stage(
        folder,
        bus_settings(**bus),
        control=control,
        missed_ticks=missed_ticks,
    )
    await stage.guards.load()
    config = uvicorn.Config(
        _ByHeader(stage.app), port=0, lifespan="off", log_level="critical", ws="websockets-sansio"
    )
    config.load()
    server = uvicorn.Server(config)
    server.lifespan = config.lifespan_class(config)
    # Without the loop of uvicorn, which looks every 0.1 s whether it is to end.
    await server.startup()
    recording = asyncio.create_task(stage.recorder.follow())
    stage.url = f"127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    try:
        yield stage
    finally:
        await stage.close()
        for listening in server.servers:
            listening.close()
        served = server.server_state
        for connection in tuple(served.connections):
            connection.shutdown()
        await until(lambda: not served.connections and not served.tasks, "the end of all connections")
        recording.cancel()
        with suppress(asyncio.CancelledError):
            await recording
        stage.database.close()


async def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition; fails with ``what`` after a generous time."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, f"never: {what}"
        await asyncio.sleep(0.002)


def result_of(command: Command, outcome: str, **more: Any) -> Result:
    """Return a command's result as the worker reports it."""
    return Result(id=command.id, at=time.time(), outcome=outcome, **more)  # type: ignore[arg-type]


def responding(outcome: str, **more: Any) -> Play:
    """To play every command to the same end."""

    async def play(command: Command) -> Sequence[Update]:
        return [result_of(command, outcome, **more)]

    return play
