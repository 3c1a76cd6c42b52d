"""A minimal app for a worker: it listens on /feed, records what it receives, and sends what the test gives
it.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from http import HTTPStatus

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from bus.contract import (
    CONTRACT_VERSION,
    Action,
    AppMessage,
    Batch,
    ClockSync,
    Command,
    Delivered,
    Hello,
    ParameterValue,
    Reading,
    Result,
    Snapshot,
    UnitLink,
    Update,
    Welcome,
    WorkerMessage,
    decode_from_worker,
    encode,
)

TOKEN = "let-me-in"
PATIENCE_S = 60.0


class FakeApp:
    """``async with FakeApp() as app``: a server on a free port, which can stop and start again."""

    def __init__(self) -> None:
        self.messages: list[WorkerMessage] = []
        self.confirms = True
        self.refuses = ""
        self.version = CONTRACT_VERSION
        self.received: dict[str, int] = {}
        self._server: Server | None = None
        self._port = 0
        self.close_codes: list[int | None] = []
        self._connection: ServerConnection | None = None
        self._count = 0
        self._news = asyncio.Event()

    async def __aenter__(self) -> FakeApp:
        await self.start()
        return self

    async def __aexit__(self, *_exc: object) -> None:
        await self.stop()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    async def start(self) -> None:
        self._server = await serve(
            self._follow, "127.0.0.1", self._port, process_request=_admit, compression=None, max_size=2**26
        )
        self._port = next(iter(self._server.sockets)).getsockname()[1]

    async def stop(self) -> None:
        assert self._server is not None
        self._server.close()
        await self._server.wait_closed()
        self._connection = None

    async def _follow(self, connection: ServerConnection) -> None:
        try:
            hello = decode_from_worker(await _bytes_of(connection))
            assert isinstance(hello, Hello)
            self._keep(hello)
            seq = self.received.setdefault(hello.worker, 0)
            welcome = Welcome(self.version, seq, time.time(), self.refuses)
            await connection.send(encode(welcome))
            self._connection = connection
            while True:
                message = decode_from_worker(await _bytes_of(connection))
                self._keep(message)
                if isinstance(message, Batch):
                    self.received[hello.worker] = message.seq
                    if self.confirms:
                        await connection.send(encode(Delivered(seq=message.seq)))
        except ConnectionClosed:
            self.close_codes.append(connection.close_code)
            self._news.set()

    def _keep(self, message: WorkerMessage) -> None:
        self.messages.append(message)
        self._news.set()

    async def send(self, message: AppMessage) -> None:
        """To the worker that is connected."""
        assert self._connection is not None
        await self._connection.send(encode(message))

    async def until(self, true: Callable[[], object], patience_s: float = PATIENCE_S) -> None:
        """Wait for something that messages bring about."""
        async with asyncio.timeout(patience_s):
            while not true():
                self._news.clear()
                await self._news.wait()

    async def perform(self, action: Action, timeout_s: float = 2.0, command_id: str = "") -> Result:
        """Command the worker and wait for the result."""
        self._count += 1
        command_id = command_id or f"command-{self._count}"
        await self.send(ClockSync(app_time=time.time()))
        await self.send(Command(command_id, time.time() + timeout_s, action))
        await self.until(lambda: self.results(command_id))
        return self.results(command_id)[0]

    def results(self, command_id: str) -> list[Result]:
        return [each for each in self.updates() if isinstance(each, Result) and each.id == command_id]

    def updates(self) -> list[Update]:
        return [update for batch in self.batches() for update in batch.updates]

    def batches(self) -> list[Batch]:
        return [message for message in self.messages if isinstance(message, Batch)]

    def snapshots(self) -> list[Snapshot]:
        return [message for message in self.messages if isinstance(message, Snapshot)]

    def readings(self, unit: int | None = None) -> list[Reading]:
        return [each for each in self.updates() if isinstance(each, Reading) and unit in (None, each.unit)]

    def read(self, number: int) -> set[int]:
        """Return the units whose parameter ``number`` was reported."""
        values = (each for each in self.updates() if isinstance(each, ParameterValue))
        return {value.unit for value in values if value.number == number}

    def links(self, unit: int) -> list[str]:
        return [each.link for each in self.updates() if isinstance(each, UnitLink) and each.unit == unit]


async def _bytes_of(connection: ServerConnection) -> bytes:
    data = await connection.recv()
    assert isinstance(data, bytes)
    return data


def _admit(connection: ServerConnection, request: Request) -> Response | None:
    if request.path == "/feed" and request.headers.get("Authorization") == f"Bearer {TOKEN}":
        return None
    return connection.respond(HTTPStatus.UNAUTHORIZED, "who are you?\n")
