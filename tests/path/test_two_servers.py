"""Two servers on one database and one device server: killed, frozen, and what the wire has seen of it.

The device server takes any number of connections, as one would that is set up wrongly: nothing but the
lease keeps two writers apart. It notes each piece that it receives, by connection and time, and the test
judges that record alone.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest

from tests import fork_server
from tests.e2e.limits import CALL_S
from tests.e2e.site import command, eventually
from tests.free_port import free_port
from tests.path.independent_unit import Unit, cut_frame
from tests.postgresql import fresh_database, needs_postgresql

PASSWORD = "correct horse battery"
BAUD = 9600
BYTE_S = 10 / BAUD
TAKE_OVER_S = 30.0
"""For a condition that is awaited, on a busy machine; the figure is measured elsewhere."""


class Piece(NamedTuple):
    """What came to the device server at once."""

    at: float
    connection: int
    data: bytes


@dataclass
class DeviceServer:
    """Units behind ``socket://``; responses go to the connection that requested."""

    units: dict[int, Unit]
    pieces: list[Piece] = field(default_factory=list)
    connected: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                self.connected += 1
                threading.Thread(target=self._serve, args=(connection, self.connected), daemon=True).start()

    def _serve(self, connection: socket.socket, number: int) -> None:
        buffer = bytearray()
        with suppress(OSError), connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while data := connection.recv(4096):
                with self._lock:
                    self.pieces.append(Piece(time.monotonic(), number, data))
                buffer += data
                while (body := cut_frame(buffer)) is not None:
                    unit = self.units.get(body[0])
                    reply = unit.respond(body) if unit is not None else None
                    time.sleep(len(data) * BYTE_S)
                    if reply:
                        connection.sendall(reply)

    def writers(self) -> list[int]:
        """The connections that wrote, in order, each change of writer once."""
        with self._lock:
            numbers = [piece.connection for piece in self.pieces]
        return [number for place, number in enumerate(numbers) if not place or numbers[place - 1] != number]


@dataclass
class Host:
    """One server of the site."""

    name: str
    config: Path
    url: str
    process: fork_server.ForkedProcess
    token: str

    def get(self, path: str) -> Any:
        headers = {"Authorization": f"Bearer {self.token}"}
        with suppress(httpx.HTTPError):
            response = httpx.get(f"{self.url}{path}", headers=headers, timeout=CALL_S, trust_env=False)
            return response.json() if response.status_code == 200 else None
        return None

    def serves(self) -> bool:
        return self.get("/healthz") is not None

    def shows_live(self) -> bool:
        """Whether it is the home of the bus, and its units respond."""
        found = self.get("/api/v1/sites")
        line = found["lines"][0] if found else {"home": None}
        is_home = line["home"] == self.name and not line["stale"]
        return is_home and line["states"].get("online") == line["units"]

    def pids(self) -> list[int]:
        """The server and its workers."""
        return [self.process.pid, *_children(self.process.pid)]


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            found += [int(word) for word in task.read_text().split()]
    return found


def configuration(folder: Path, name: str, port: int, url: str, device: DeviceServer) -> Path:
    config = folder / name / "lineside.toml"
    config.parent.mkdir()
    units = "".join(f'[[bus.unit]]\nid = {number}\nname = "Unit {number}"\n' for number in device.units)
    config.write_text(
        f"""\
[server]
id = "{name}"
port = {port}
data = "data"
[audit]
key_file = "../audit.key"
[store]
url = "{url}"
[[bus]]
name = "dry-end"
port = "socket://127.0.0.1:{device.port}"
{units}"""
    )
    return config


@contextmanager
def two_servers(folder: Path) -> Iterator[tuple[Host, Host, DeviceServer]]:
    """The first is the home of the bus when this begins."""
    device = DeviceServer({number: Unit(number, commanded=1000, actual=1000) for number in (1, 2)})
    with fresh_database() as store, ExitStack() as stack:
        stack.callback(device.close)
        hosts: list[Host] = []
        token = ""
        for name in ("a", "b"):
            port = free_port()
            config = configuration(folder, name, port, store.url, device)
            if not token:
                token = command(config, "token", "create", "test", "--role", "operator").strip()
            log = stack.enter_context((config.parent / "log").open("ab"))
            process = fork_server.start("serve", "--config", config, stdout=log, stderr=log)
            stack.callback(end_server, process)
            host = Host(name, config, f"http://127.0.0.1:{port}", process, token)
            hosts.append(host)
            what = f"{name} serves: {(config.parent / 'log').read_text()[-2000:]}"
            eventually(host.serves, what, within=TAKE_OVER_S)
            if name == "a":
                eventually(host.shows_live, "the first is the home", within=TAKE_OVER_S)
        yield hosts[0], hosts[1], device


def end_server(process: fork_server.ForkedProcess) -> None:
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
        process.kill()
    process.wait()


@pytest.mark.soak
@needs_postgresql
def test_servers_that_are_killed_and_stand_still_never_write_beside_each_other(tmp_path: Path) -> None:
    """One site, since the start of two servers takes most of the time."""
    with two_servers(tmp_path) as (a, b, device):
        a_person_takes_it(b)
        the_server_alone_stands_still(b, a, device)
        the_server_and_its_worker_stand_still(a, b, device)
        b.process.kill()
        eventually(a.shows_live, "the first has the bus of the one that was killed", within=TAKE_OVER_S)
        writers = device.writers()
        assert len(writers) >= 5
        assert writers == sorted(writers), "no former writer comes back, and no two by turns"
        assert device.units[1].commanded == 1000, "no command after its deadline"


def a_person_takes_it(taker: Host) -> None:
    words = ("home", "take", "dry-end", "--reason", "maintenance of a", "--config", str(taker.config))
    done = fork_server.run(*words)
    assert (done.returncode, done.stderr) == (0, "")
    eventually(taker.shows_live, "the second has it from a person", within=TAKE_OVER_S)
    shown = fork_server.run("home", "--json", "--config", str(taker.config)).stdout
    assert '"server": "b"' in shown
    events = taker.get("/api/v1/events?limit=50&kind=home")["events"]
    assert any("maintenance of a" in str(event) for event in events)


def the_server_alone_stands_still(holder: Host, taker: Host, device: DeviceServer) -> None:
    """Its worker runs on, and closes the port by its own clock."""
    os.kill(holder.process.pid, signal.SIGSTOP)
    eventually(taker.shows_live, "the other has it from a server that stands still", within=TAKE_OVER_S)
    os.kill(holder.process.pid, signal.SIGCONT)
    goes_on_polling(device)


def the_server_and_its_worker_stand_still(holder: Host, taker: Host, device: DeviceServer) -> None:
    """Whatever they find in their sockets when they go on, they write nothing."""
    stopped = holder.pids()
    assert len(stopped) > 1, "its worker runs"
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    with httpx.Client(base_url=holder.url, timeout=0.2, trust_env=False) as client:
        headers = {"Authorization": f"Bearer {holder.token}"}
        with suppress(httpx.HTTPError):
            client.post("/api/v1/buses/dry-end/units/1/speed", json={"raw": 4321}, headers=headers)
    eventually(taker.shows_live, "the other has it from a process that stands still", within=TAKE_OVER_S)
    for pid in stopped:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    goes_on_polling(device)


def goes_on_polling(device: DeviceServer) -> None:
    """For long enough that a former holder would have written."""
    seen = len(device.pieces)
    eventually(lambda: len(device.pieces) > seen + 100, "the holder goes on polling", within=TAKE_OVER_S)
