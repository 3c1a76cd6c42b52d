"""Writes that wait in the kernel while the server is suspended, starts, or is busy with the request before.

The test is what reached the units: nothing after its time. The server, the worker and the units are separate
processes and threads; only their suspension is simulated, by signals.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests import fork_server
from tests.e2e.limits import START_S
from tests.e2e.site import end, eventually, people
from tests.free_port import free_port
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Unit

GIVEN_S, HELD_S = 1.0, 1.5
BACKLOG = 60
"""The server accepts one in each iteration of its loop."""
OTHER_UNIT, UNIT = 2, 1


@dataclass
class Client:
    """One connection of a program that writes whenever it likes, without waiting for responses."""

    address: tuple[str, int]
    token: str
    socket: socket.socket = field(init=False)
    received: bytes = b""

    def __post_init__(self) -> None:
        self.socket = socket.create_connection(self.address, timeout=60)

    def send(self, method: str, path: str, body: Any = None, *, parts: int = 1) -> None:
        """One request, in so many packets."""
        content = b"" if body is None else json.dumps(body).encode()
        head = (
            f"{method} {path} HTTP/1.1\r\nHost: {self.address[0]}\r\nAuthorization: Bearer {self.token}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {len(content)}\r\n\r\n"
        ).encode()
        for packet in (head, content) if parts == 2 else (head + content,):
            self.socket.sendall(packet)

    def set_speed(
        self, raw: int, unit: int = UNIT, *, timeout_s: float | None = GIVEN_S, parts: int = 1
    ) -> None:
        """84h, to be sent within so many seconds."""
        body = {"raw": raw} if timeout_s is None else {"raw": raw, "timeout_s": timeout_s}
        self.send("POST", f"/api/v1/buses/dry-end/units/{unit}/speed", body, parts=parts)

    def response(self) -> tuple[int, Any]:
        """The next: status and JSON."""
        head = self._until(b"\r\n\r\n")
        length = next(
            int(line.partition(b":")[2])
            for line in head.lower().split(b"\r\n")
            if line.startswith(b"content-length")
        )
        while len(self.received) < length:
            self._receive()
        content, self.received = self.received[:length], self.received[length:]
        return int(head.split()[1]), json.loads(content)

    def _until(self, mark: bytes) -> bytes:
        while mark not in self.received:
            self._receive()
        found, _, self.received = self.received.partition(mark)
        return found

    def _receive(self) -> None:
        data = self.socket.recv(65536)
        assert data, "the server closed the connection"
        self.received += data


Connect = Callable[[int], Client]


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Another program at a port of this machine; all hang up at the end."""
    with ExitStack() as open_ones:

        def made(port: int) -> Client:
            program = Client(("127.0.0.1", port), people()[1]["operator"])
            open_ones.callback(program.socket.close)
            return program

        yield made


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    with dashboard(tmp_path_factory.mktemp("stalled"), [Unit(UNIT), Unit(OTHER_UNIT)]) as made:
        yield made


def port_of(plant: Dashboard) -> int:
    """Where it listens."""
    return int(plant.url.rpartition(":")[2])


def server_of(plant: Dashboard) -> int:
    """The process that serves, the parent of the bus worker (proc(5))."""
    (worker,) = plant.workers()
    return int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])


@contextmanager
def standing_still(process: int) -> Iterator[None]:
    """For as long as the block, and longer than a write is given."""
    os.kill(process, signal.SIGSTOP)
    began = time.monotonic()
    try:
        yield
        eventually(lambda: time.monotonic() > began + HELD_S, "the time of every write over")
    finally:
        os.kill(process, signal.SIGCONT)


def speeds_at_the_unit(plant: Dashboard) -> set[int]:
    """Every setpoint that has reached the unit (84h)."""
    writes = plant.cable.units[UNIT].writes
    return {int.from_bytes(data, "big") for command, _, data in writes if command == 0x84}


def test_what_waited_while_the_server_stood_still_is_not_sent(plant: Dashboard, connect: Connect) -> None:
    kept, in_two_packets, followed, pipelined = (connect(port_of(plant)) for _ in range(4))
    for one in (kept, in_two_packets, followed, pipelined):
        one.send("GET", "/healthz")
        assert one.response()[0] == 200
    with standing_still(server_of(plant)):
        kept.set_speed(101)
        in_two_packets.set_speed(102, parts=2)
        followed.set_speed(103)
        pipelined.send("GET", "/api/v1/line")
        pipelined.set_speed(104)
        backlog = [connect(port_of(plant)) for _ in range(BACKLOG)]
        for late in backlog:
            late.set_speed(105)
    # The last byte of this connection is young; the first is not.
    followed.send("GET", "/healthz")
    assert pipelined.response()[0] == 200
    for late in (kept, in_two_packets, followed, pipelined, *backlog):
        assert _outcome(late) == (503, "not_sent")
    fresh = connect(port_of(plant))
    fresh.set_speed(110, timeout_s=None)
    assert fresh.response()[0] == 200
    assert speeds_at_the_unit(plant) == {110}


def test_what_waited_behind_a_slow_request_of_its_connection_is_not_sent(
    plant: Dashboard, connect: Connect
) -> None:
    """The bus worker stands still, so the first write gets no result before its time is over."""
    before = speeds_at_the_unit(plant)
    (worker,) = plant.workers()
    program = connect(port_of(plant))
    with standing_still(worker):
        program.set_speed(201, OTHER_UNIT, timeout_s=HELD_S)
        program.set_speed(202)
        program.set_speed(203)
    assert program.response()[0] in (503, 504)
    for _ in range(2):
        assert _outcome(program) == (503, "not_sent")
    eventually(lambda: plant.unit(UNIT)["link"] == "online", "the worker back")
    assert speeds_at_the_unit(plant) == before
    program.set_speed(210, timeout_s=None)
    assert program.response()[0] == 200


def test_what_waited_for_the_start_is_not_sent_and_what_follows_at_once_is_not_late(
    tmp_path: Path, connect: Connect
) -> None:
    """The port is open long before the server serves."""
    config, port = tmp_path / "lineside.toml", free_port()
    shutil.copytree(people()[0], tmp_path / "data")
    config.write_text(
        f'[server]\nport = {port}\ndata = "./data"\n'
        f'[[bus]]\nname = "dry-end"\nport = "{tmp_path}/absent"\n[[bus.unit]]\nid = 1\nname = "Unwind"\n'
    )
    with (tmp_path / "serve.log").open("ab") as log:
        server = fork_server.start("serve", "--config", config, stdout=log, stderr=log)
    try:
        early = eventually(lambda: _connected(connect, port), "the port open", within=START_S)
        early.set_speed(301)
        with standing_still(server.pid):
            pass
        assert _outcome(early) == (503, "not_sent")
        prompt = connect(port)
        prompt.send("GET", "/healthz")
        assert prompt.response() == (200, {"status": "ok"})
        for program in (prompt, connect(port)):
            program.set_speed(302, timeout_s=None, parts=2)
            assert _outcome(program) == (503, "bus_closed"), "no other reason not to send it"
    finally:
        end(server)


def _outcome(program: Client) -> tuple[int, str]:
    status, result = program.response()
    return status, result["code"]


def _connected(connect: Connect, port: int) -> Client | None:
    with suppress(OSError):
        return connect(port)
    return None
