"""The OPC UA process as the server runs it, fed by a test, and clients of it with their own certificates."""

from __future__ import annotations

import asyncio
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography.hazmat.primitives.serialization import Encoding

from app.people.auth.rules import secret_hash
from app.system.opcua.access import OwnCertificate, own_certificate
from app.system.opcua.link import (
    Begin,
    Changes,
    Frames,
    Key,
    Keys,
    StandingAlarm,
    Status,
    ToProcess,
    UnitAlarms,
    frame,
    from_process,
)
from bus.contract import BusLink, ParameterValue, Reading, UnitLink
from bus.instants import UnixTime, unix_now
from bus.settings import BusSettings, UnitSettings
from tests.free_port import free_port

TOKEN, SECRET = "historian", "s3cret-of-the-token"
LABELS: Any = {"unit": "m/min", "analog_unit": "N", "output": {1: "Brake"}}


def line(names: Sequence[str] = ("Unwind", "Rewind", "Spare")) -> BusSettings:
    units = tuple(UnitSettings(id=number, name=name, labels=LABELS) for number, name in enumerate(names, 1))
    return BusSettings(name="dry-end", port="/dev/null", unit=units)


def scales(unit: int, at: UnixTime) -> list[Any]:
    raw = {2: 20_000, 3: 1, 8: 0, 22: 0, 23: 510}
    return [ParameterValue(unit, number, at, value) for number, value in raw.items()]


def responds(unit: int, at: UnixTime, actual: int = 1234) -> list[Any]:
    return [UnitLink(unit, at, "online"), Reading(unit, at, 1200, actual, 51, 0xC0, 0b11)]


def client_certificate(folder: Path, name: str = "Historian") -> OwnCertificate:
    """Make a certificate of a client with its key, in ``folder``."""
    return own_certificate(folder, (), name, datetime.now(UTC))


@dataclass
class OpcuaServer:
    """The OPC UA process of a test. ``folder``: of its certificates; ``status``: the newest that it
    reported."""

    folder: Path
    bus: BusSettings = field(default_factory=line)
    port: int = field(default_factory=free_port)
    status: Status = field(default_factory=Status)
    _process: Process | None = None
    _listening: asyncio.Task[None] | None = None

    @property
    def url(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.port}/"

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def send(self, message: ToProcess) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(frame(message))

    def report(self, *updates: Any) -> None:
        """Report updates of the bus."""
        self.send(Changes(self.bus.name, list(updates)))

    def alarms(self, of_units: dict[int, list[StandingAlarm]]) -> None:
        self.send(UnitAlarms(self.bus.name, of_units))

    def tokens(self, *names: str) -> None:
        """Make these the only tokens, all with one secret."""
        self.send(Keys([Key(id_, name, secret_hash(SECRET), None) for id_, name in enumerate(names, 7)]))

    def trust(self, client: OwnCertificate) -> Path:
        """Trust a client, by its certificate in ``trusted``."""
        file = self.folder / "trusted" / f"{client.certificate.serial_number}.der"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(client.certificate.public_bytes(Encoding.DER))
        return file

    async def until(self, holds: Callable[[Status], object], within_s: float = 180.0) -> None:
        """Wait until the process reports a status that ``holds``."""
        end = time.monotonic() + within_s
        while not holds(self.status):
            assert time.monotonic() < end, self.status
            await asyncio.sleep(0.05)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[OpcuaServer]:
        """Run the process until the context ends."""
        words = (sys.executable, "-P", "-m", "app.cli.opcua")
        self._process = await asyncio.create_subprocess_exec(*words, stdin=PIPE, stdout=PIPE)
        self._listening = asyncio.create_task(self._listen(self._process))
        names = ["127.0.0.1"]
        bus = self.bus.model_dump_json()
        where = ("127.0.0.1", self.port, str(self.folder))
        self.send(Begin("Mill 7", "1.2.3", *where, names, "Maker", "4711", [bus]))
        self.report(BusLink(unix_now(), "open"))
        self.tokens(TOKEN)
        try:
            await self.until(lambda status: status.is_serving)
            yield self
        finally:
            self._process.stdin.close()  # type: ignore[union-attr]
            with suppress(ProcessLookupError):
                await asyncio.wait_for(self._process.wait(), 180)
            self._listening.cancel()

    async def _listen(self, process: Process) -> None:
        assert process.stdout is not None
        frames = Frames(from_process)
        while data := await process.stdout.read(65_536):
            for self.status in frames.feed(data):
                pass


@asynccontextmanager
async def connected(
    server: OpcuaServer, client: OwnCertificate, folder: Path, user: str = TOKEN, secret: str = SECRET
) -> AsyncIterator[Client]:
    """Connect a client of asyncua with a session. ``folder``: of the certificate of the client."""
    made = await secured(server, client, folder)
    made.set_user(user)
    made.set_password(secret)
    try:
        await made.connect()
        yield made
    finally:
        # The server may have ended the connection.
        with suppress(ConnectionError, TimeoutError, ua.UaError):
            await made.disconnect()


async def secured(server: OpcuaServer, client: OwnCertificate, folder: Path) -> Client:
    """Return a client of asyncua that is not connected yet."""
    made = Client(server.url, timeout=60)
    made.application_uri = client.uri
    mode = ua.MessageSecurityMode.SignAndEncrypt
    files = (folder / "own" / "certificate.pem", folder / "own" / "key.pem")
    own = server.folder / "own" / "certificate.pem"
    await made.set_security(
        SecurityPolicyBasic256Sha256, *map(str, files), server_certificate=str(own), mode=mode
    )
    return made
