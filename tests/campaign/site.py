"""The site of a campaign: the device server in front of simulated units, and the app servers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests import unpacked
from tests.campaign.checker.records import CONNECTIONS, WIRE
from tests.campaign.network import Machine, call

LINESIDE = Path(sys.executable).with_name("lineside")
ROOT = Path(__file__).resolve().parents[2]
BUS, UNITS = "line", 8
DEVICE_PORT, UNITS_PORT, SERVER_PORT = 4001, 4100, 8000
TURNAROUND_MS = 200
"""A response passes a device server, a network and recorders, on a computer that runs everything else."""
INACTIVITY_S = 3
"""After so long without a byte the device server gives the port to the next: a stopped worker holds it no
longer."""
PATIENCE_S = 180.0
"""A server that starts while others load the machine."""
FAKETIME = "usr/lib/*-linux-gnu/faketime/libfaketimeMT.so.1"
SER2NET = """\
connection: &{bus}
    accepter: tcp,0.0.0.0,{port}
    timeout: {inactivity}
    connector: serialdev,{device},9600n81,local
"""


def started(machine: Machine, *words: object, log: Path, **environment: str) -> subprocess.Popen[bytes]:
    """A program of this tree on a machine."""
    return machine.start(*words, log=log, env={**os.environ, "PYTHONPATH": str(ROOT), **environment})


@dataclass
class Device:
    """ser2net with one port, the recorders, and the units behind it."""

    folder: Path
    machine: Machine
    server: subprocess.Popen[bytes] | None = None

    def start(self, seed: int) -> None:
        log, link = self.folder / "device.log", self.folder / "tty"
        units = ("--units", UNITS, "--tcp", UNITS_PORT, "--seed", seed, "--turnaround-ms", 5)
        started(self.machine, LINESIDE, "simulate", *units, log=log)
        _wait_for(lambda: "socket://" in log.read_text(), log)
        recorder = (sys.executable, "-m", "tests.campaign.recorders")
        wire, connections = (self.folder / name.format(bus=BUS) for name in (WIRE, CONNECTIONS))
        started(self.machine, *recorder, "wire", wire, link, UNITS_PORT, log=log)
        started(self.machine, *recorder, "connections", connections, DEVICE_PORT, log=log)
        _wait_for(link.is_symlink, log)
        (self.folder / "ser2net.yaml").write_text(
            SER2NET.format(bus=BUS, port=DEVICE_PORT, device=link, inactivity=INACTIVITY_S)
        )
        self.start_server()

    def start_server(self) -> None:
        """Start ser2net, also after it was killed."""
        if self.server is not None:
            # As init does: one that is not waited for still has the lock file of its device.
            self.server.wait()
        command = (unpacked.program("ser2net"), "-n", "-c", self.folder / "ser2net.yaml")
        log, environment = self.folder / "ser2net.log", unpacked.environment("ser2net")
        self.server = self.machine.start(*command, log=log, env=environment)

    def signal(self, number: int) -> None:
        assert self.server is not None
        self.server.send_signal(number)


@dataclass
class AppServer:
    """``lineside serve`` on a machine, with a clock that faults may move."""

    folder: Path
    machine: Machine
    environment: dict[str, str] = field(default_factory=dict)

    @property
    def url(self) -> str:
        return f"http://{self.machine.address}:{SERVER_PORT}"

    @property
    def config(self) -> Path:
        return self.folder / "lineside.toml"

    def configure(self, device: Machine) -> None:
        """Write its lineside.toml."""
        self.folder.mkdir()
        units = "".join(f'[[bus.unit]]\nid = {unit}\nname = "Unit {unit}"\n' for unit in range(1, UNITS + 1))
        host = self.machine.address
        self.config.write_text(
            f'[site]\nname = "Campaign"\n[server]\nhost = "{host}"\nport = {SERVER_PORT}\n'
            f'data = "data"\n[[bus]]\nname = "{BUS}"\nport = "socket://{device.address}:{DEVICE_PORT}"\n'
            f"turnaround_ms = {TURNAROUND_MS}\n{units}"
        )
        self.environment = self._movable_clock()

    def _movable_clock(self) -> dict[str, str]:
        """The environment in which the clock of a program is what ``set_clock`` makes it; none: it cannot."""
        libraries = unpacked.beside("ser2net", FAKETIME)
        if not libraries:
            return {}
        self.set_clock(0.0)
        return {
            "LD_PRELOAD": libraries[0],
            "FAKETIME_TIMESTAMP_FILE": str(self.folder / "clock"),
            "FAKETIME_CACHE_DURATION": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "NO_FAKE_STAT": "1",
        }

    def set_clock(self, ahead_s: float) -> None:
        fresh = self.folder / "clock.new"
        fresh.write_text(f"{ahead_s:+.1f}\n")
        fresh.replace(self.folder / "clock")

    def command(self, *words: object, text: str = "") -> str:
        """Run ``lineside …`` on its configuration."""
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        inside = (*self.machine.inside, LINESIDE, *words, "--config", self.config)
        return call(*inside, input=text, env=environment)

    def start(self) -> None:
        started(
            self.machine, LINESIDE, "serve", "--config", self.config,
            log=self.folder / "serve.log", **self.environment,
        )  # fmt: skip

    def wait_until_it_serves(self) -> None:
        probe = [*self.machine.inside, "curl", "-sf", "-m", "2", f"{self.url}/healthz"]
        _wait_for(
            lambda: not subprocess.run(probe, capture_output=True).returncode, self.folder / "serve.log"
        )

    def workers(self) -> list[int]:
        """The bus workers that it has started."""
        return [
            process
            for process in self.machine.processes()
            if b"\0bus\0" in Path(f"/proc/{process}/cmdline").read_bytes()
        ]


def signal_all(processes: list[int], number: signal.Signals) -> None:
    for process in processes:
        os.kill(process, number)


def _wait_for(condition: object, log: Path) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end, log.read_text()[-3000:]
        time.sleep(0.1)
