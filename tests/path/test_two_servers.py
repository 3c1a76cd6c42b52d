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
        """Whether its own live state has units that respond."""
        line = self.get("/api/v1/line")
        return line is not None and all(unit["link"] == "online" for unit in line["buses"][0]["units"])

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
    with ExitStack() as stack, fresh_database() as store:
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
            stack.callback(_end, process)
            host = Host(name, config, f"http://127.0.0.1:{port}", process, token)
            hosts.append(host)
            what = f"{name} serves: {(config.parent / 'log').read_text()[-2000:]}"
            eventually(host.serves, what, within=TAKE_OVER_S)
            if name == "a":
                eventually(host.shows_live, "the first is the home", within=TAKE_OVER_S)
        yield hosts[0], hosts[1], device


def _end(process: fork_server.ForkedProcess) -> None:
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
        process.kill()
    process.wait()


@needs_postgresql
def test_the_other_server_takes_the_bus_of_one_that_is_killed(tmp_path: Path) -> None:
    with two_servers(tmp_path) as (a, b, device):
        killed = time.monotonic()
        for pid in a.pids()[:1]:
            os.kill(pid, signal.SIGKILL)
        eventually(b.shows_live, "the second shows live values", within=TAKE_OVER_S)
        print("taken over after", round(time.monotonic() - killed, 1), "s")
        assert device.writers() == [1, 2]


@needs_postgresql
def test_one_that_stood_still_writes_nothing_more(tmp_path: Path) -> None:
    with two_servers(tmp_path) as (a, b, device):
        stopped = a.pids()
        assert len(stopped) > 1, "its worker runs"
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        eventually(b.shows_live, "the second shows live values", within=TAKE_OVER_S)
        # A command to the old home, which it finds in its socket when it goes on.
        with httpx.Client(base_url=a.url, timeout=0.2, trust_env=False) as client:
            headers = {"Authorization": f"Bearer {a.token}"}
            with suppress(httpx.HTTPError):
                client.post("/api/v1/buses/dry-end/units/1/speed", json={"raw": 4321}, headers=headers)
        seen = len(device.pieces)
        for pid in stopped:
            os.kill(pid, signal.SIGCONT)
        eventually(lambda: len(device.pieces) > seen + 100, "the second goes on polling", within=TAKE_OVER_S)
        assert device.writers() == [1, 2], "the first wrote nothing after it went on"
        assert device.units[1].commanded == 1000, "no command after its deadline"


@needs_postgresql
def test_the_child_of_a_server_that_stands_still_closes_its_port(tmp_path: Path) -> None:
    """The server alone is frozen; its worker runs on, and must stop by its own clock."""
    with two_servers(tmp_path) as (a, b, device):
        os.kill(a.process.pid, signal.SIGSTOP)
        eventually(b.shows_live, "the second shows live values", within=TAKE_OVER_S)
        os.kill(a.process.pid, signal.SIGCONT)
        seen = len(device.pieces)
        eventually(lambda: len(device.pieces) > seen + 100, "the second goes on polling", within=TAKE_OVER_S)
        assert device.writers() == [1, 2]


@needs_postgresql
def test_a_person_takes_the_bus_to_the_other_server(tmp_path: Path) -> None:
    with two_servers(tmp_path) as (_, b, device):
        done = fork_server.run(
            "home", "take", "dry-end", "--reason", "maintenance of a", "--config", str(b.config)
        )
        assert (done.returncode, done.stderr) == (0, "")
        eventually(b.shows_live, "the second shows live values", within=TAKE_OVER_S)
        assert device.writers() == [1, 2]
        shown = fork_server.run("home", "--json", "--config", str(b.config)).stdout
        assert '"server": "b"' in shown
        events = b.get("/api/v1/events?limit=50&kind=home")["events"]
        assert any("maintenance of a" in str(event) for event in events)
