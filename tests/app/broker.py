"""A real broker (mosquitto) for tests, which may be killed and started again, and a host that listens."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import aiomqtt
import pytest

from tests.app.fake_worker import until
from tests.app.sparkplug import Host
from tests.free_port import free_port
from tests.unpacked import beside, environment, program

FAKETIME = "usr/lib/*-linux-gnu/faketime/libfaketimeMT.so.1"


@dataclass
class Broker:
    """A mosquitto of a test, on this machine only; it keeps nothing. ``more``: lines of its configuration;
    ``clock``: the time that it believes in."""

    folder: Path
    more: str = "allow_anonymous true"
    port: int = field(default_factory=free_port)
    clock: str = ""
    _process: subprocess.Popen[bytes] | None = None

    def __post_init__(self) -> None:
        self.executable = program("mosquitto")

    def _begin(self) -> None:
        config = self.folder / "mosquitto.conf"
        config.write_text(f"listener {self.port} 127.0.0.1\npersistence false\nuser root\n{self.more}\n")
        self._process = subprocess.Popen(
            [self.executable, "-c", str(config)],
            env=environment("mosquitto", **self._other_clock()),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def _other_clock(self) -> dict[str, str]:
        if not self.clock:
            return {}
        library = beside("mosquitto", FAKETIME)
        if not library:
            pytest.skip("libfaketime is not here: make development unpacks it from Debian's packages")
        return {"LD_PRELOAD": library[0], "FAKETIME": f"@{self.clock}", "DONT_FAKE_MONOTONIC": "1"}

    async def start(self) -> None:
        """Start the broker, and wait until it listens."""
        self._begin()
        while True:
            try:
                _, writer = await asyncio.open_connection("127.0.0.1", self.port)
            except OSError:
                await asyncio.sleep(0.05)
            else:
                writer.close()
                return

    def kill(self) -> None:
        """Kill the broker, which says nothing to its clients."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.kill()

    def client(self, **more: object) -> aiomqtt.Client:
        """Return a client of the broker that is not connected yet."""
        return aiomqtt.Client("127.0.0.1", self.port, protocol=aiomqtt.ProtocolVersion.V311, **more)  # type: ignore[arg-type]


@dataclass
class Relay:
    """A connection to a broker that a test may cut, which it does for each one that ``is_cut`` names by its
    number, from 1."""

    broker: Broker
    is_cut: Callable[[int], bool] = lambda _: False
    port: int = 0
    count: int = 0
    _writers: list[asyncio.StreamWriter] = field(default_factory=list)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Relay connections for the time of the context."""
        server = await asyncio.start_server(self._connect, "127.0.0.1", self.port)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield
        finally:
            server.close()
            self.cut()

    def cut(self) -> None:
        """End every connection without a word to either side."""
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.count += 1
        if self.is_cut(self.count):
            writer.transport.abort()
            return
        inner, outer = await asyncio.open_connection("127.0.0.1", self.broker.port)
        self._writers += [writer, outer]
        with suppress(ConnectionError):
            await asyncio.gather(_copy(reader, outer), _copy(inner, writer))


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while content := await reader.read(65536):
            writer.write(content)
            await writer.drain()
    finally:
        writer.transport.abort()


@asynccontextmanager
async def running(folder: Path, more: str = "allow_anonymous true") -> AsyncIterator[Broker]:
    """Run a broker for the time of the context."""
    async with Broker(folder, more) as broker:
        yield broker


@asynccontextmanager
async def listening(broker: Broker, host: Host, **login: str) -> AsyncIterator[asyncio.Event]:
    """Let a host follow the broker for the time of the context, also after the broker was started again.

    Yields what is set while the host has its subscription: what others publish meanwhile, it misses.
    """
    ready = asyncio.Event()

    async def follow() -> None:
        while True:
            try:
                async with broker.client(**login) as client:
                    await client.subscribe(f"spBv1.0/{host.group}/#", 1)
                    ready.set()
                    async for message in client.messages:
                        topic = str(message.topic)
                        if "/STATE/" not in topic and "CMD/" not in topic:
                            assert isinstance(message.payload, bytes)
                            host.take(topic, message.payload)
            except aiomqtt.MqttError:
                ready.clear()
                await asyncio.sleep(0.05)

    task = asyncio.create_task(follow())
    await until(ready.is_set, "the host listens")
    try:
        yield ready
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
