"""A bus worker that a test plays over ``/feed``, without a socket, and the messages that one sends."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

from starlette.types import ASGIApp
from starlette.types import Message as AsgiMessage

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
    WorkerMessage,
    decode_from_app,
    encode,
)
from bus.messages import term
from bus.settings import BusSettings, UnitSettings

REMOTE, HEALTHY = 0b0100_0000, 0b0000_0010
PARAMETERS = {1: 1750, 2: 20000, 3: 1, 8: 0, 22: 0, 23: 500, 28: 2, 29: 100, 30: 2000, 12: 20}
BUS = "dry-end"
Play = Callable[[Command], Awaitable[Sequence[Update]]]


def bus_settings(**changes: Any) -> BusSettings:
    """Return one bus of three units."""
    units = tuple(UnitSettings(id=number, name=f"Unit {number}") for number in (1, 2, 16))
    return BusSettings(**{"name": BUS, "port": "/dev/null", "unit": units, **changes})


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


def hello(worker: str = "w1", bus: str = BUS, version: int = CONTRACT_VERSION) -> Hello:
    """Return the first message of a worker."""
    now = time.time()
    return Hello(version, bus, worker, now, "test", "/dev/null", now)


def result_of(command: Command, outcome: str, **more: Any) -> Result:
    """Return a command's result as the worker reports it."""
    return Result(id=command.id, at=time.time(), outcome=outcome, **more)  # type: ignore[arg-type]


def responding(outcome: str, **more: Any) -> Play:
    """Return a play that gives every command the same outcome."""

    async def play(command: Command) -> Sequence[Update]:
        return [result_of(command, outcome, **more)]

    return play


async def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition; fail with ``what`` after a generous time."""
    end = time.monotonic() + 180
    while not condition():
        assert time.monotonic() < end, f"never: {what}"
        await asyncio.sleep(0.002)


@dataclass(frozen=True)
class HandshakeRefused(Exception):
    """The response to a handshake that opened no WebSocket."""

    status: int
    body: bytes


class PlayedWorker:
    """A worker that the test controls. ``play`` responds to commands; ``received`` has the app's messages;
    ``closed`` is the reason for which the app ended the connection."""

    def __init__(self, app: ASGIApp, headers: dict[str, str]) -> None:
        self.seq = 0
        self.received: list[AppMessage] = []
        self.commands: list[Command] = []
        self.play: Play | None = None
        self.closed: str | None = None
        self._sent: asyncio.Queue[AsgiMessage] = asyncio.Queue()
        self._answers: asyncio.Queue[AsgiMessage] = asyncio.Queue()
        scope = {
            "type": "websocket",
            "asgi": {"version": "3.0", "spec_version": "2.4"},
            "http_version": "1.1",
            "scheme": "ws",
            "path": "/feed",
            "raw_path": b"/feed",
            "query_string": b"",
            "subprotocols": [],
            "headers": [(name.lower().encode(), value.encode()) for name, value in headers.items()],
            "client": ("127.0.0.1", 4711),
            "server": ("127.0.0.1", 80),
            "extensions": {"websocket.http.response": {}},
        }
        self._serving = asyncio.create_task(app(scope, self._sent.get, self._answers.put))  # type: ignore[arg-type]
        self._listening: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Open the connection. Raises HandshakeRefused."""
        self._sent.put_nowait({"type": "websocket.connect"})
        answer = await self._answers.get()
        if answer["type"] == "websocket.accept":
            self._listening = asyncio.create_task(self._listen())
            return
        body = b""
        if answer["type"] == "websocket.http.response.start":
            body = (await self._answers.get())["body"]
        raise HandshakeRefused(answer.get("status", 403), body)

    async def send(self, message: WorkerMessage) -> None:
        """Send one message."""
        await self.send_raw(encode(message))

    async def send_raw(self, data: bytes | str) -> None:
        """Send a frame of anything at all."""
        kind = "text" if isinstance(data, str) else "bytes"
        self._sent.put_nowait({"type": "websocket.receive", kind: data})

    async def update(self, *updates: Update) -> None:
        """Send the next batch."""
        self.seq += 1
        await self.send(Batch(self.seq, time.time(), list(updates), app_behind_s=0.0))

    async def receive(self, kind: type[AppMessage], count: int = 1) -> AppMessage:
        """Wait for ``count`` messages of this kind; return the last one."""
        await until(lambda: len(self._of(kind)) >= count, f"{count} times {kind.__name__}")
        return self._of(kind)[count - 1]

    async def gone(self) -> str:
        """Wait until the app ended the connection; return its reason."""
        await until(lambda: self.closed is not None, "the end of the connection")
        assert self.closed is not None
        return self.closed

    async def leave(self, code: int = 1000) -> None:
        """End the connection, and wait until the app has noticed."""
        self._sent.put_nowait({"type": "websocket.disconnect", "code": code})
        await asyncio.wait({self._serving})

    async def end(self) -> None:
        """Let go of the app, as a process that is killed does."""
        if not self._serving.done():
            await self.leave()
        if self._listening is not None:
            self._listening.cancel()
            await asyncio.wait({self._listening})

    def _of(self, kind: type[AppMessage]) -> list[AppMessage]:
        return [message for message in self.received if isinstance(message, kind)]

    async def _listen(self) -> None:
        while (answer := await self._answers.get())["type"] == "websocket.send":
            await self._take(decode_from_app(answer["bytes"]))
        self.closed = answer.get("reason") or ""
        self._sent.put_nowait({"type": "websocket.disconnect", "code": answer.get("code", 1000)})

    async def _take(self, message: AppMessage) -> None:
        self.received.append(message)
        if isinstance(message, Command):
            self.commands.append(message)
            if self.play is not None:
                await self.update(*await self.play(message))
