"""The site of a campaign: the server, its two lines of simulated units, and the device server of one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests import unpacked
from tests.campaign.checker.records import CONNECTIONS, KEYPADS, WIRE
from tests.campaign.network import Machine, call

LINESIDE = Path(sys.executable).with_name("lineside")
ROOT = Path(__file__).resolve().parents[2]
LINE, CABLE = "line", "cable"
"""The bus behind the device server, and the one at a port of the server itself."""
BUSES, UNITS = (LINE, CABLE), 8
DEVICE_PORT, SERVER_PORT = 4001, 8000
UNITS_PORTS, CONTROL_PORTS = {LINE: 4100, CABLE: 4101}, {LINE: 4200, CABLE: 4201}
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
    """The units of both buses with their recorders, those who meddle with them, and ser2net with one port.

    The recorder of the cable gives a pseudo-terminal, which exists for all machines.
    """

    folder: Path
    machine: Machine
    server: subprocess.Popen[bytes] | None = None

    def link(self, bus: str) -> Path:
        """The port of a bus."""
        return self.folder / f"tty-{bus}"

    def start(self, seed: int) -> None:
        log = self.folder / "device.log"
        recorder = (sys.executable, "-m", "tests.campaign.recorders")
        for bus in BUSES:
            simulated, link, wire = self.folder / f"{bus}.log", self.link(bus), WIRE.format(bus=bus)
            ports = ("--tcp", UNITS_PORTS[bus], "--control", CONTROL_PORTS[bus])
            units = ("--units", UNITS, *ports, "--seed", seed, "--turnaround-ms", 5)
            started(self.machine, LINESIDE, "simulate", *units, log=simulated)
            _wait_for(lambda simulated=simulated: "control" in simulated.read_text(), simulated)
            started(self.machine, *recorder, "wire", self.folder / wire, link, UNITS_PORTS[bus], log=log)
            _wait_for(link.is_symlink, log)
        arrivals = self.folder / CONNECTIONS.format(bus=LINE)
        started(self.machine, *recorder, "connections", arrivals, DEVICE_PORT, log=log)
        (self.folder / "ser2net.yaml").write_text(
            SER2NET.format(bus=LINE, port=DEVICE_PORT, device=self.link(LINE), inactivity=INACTIVITY_S)
        )
        self.start_server()

    def meddle(self, seed: int) -> None:
        """Let others change scales at the keypads, and the settings of the port."""
        meddling = (sys.executable, "-m", "tests.campaign.meddling")
        log = self.folder / "device.log"
        for bus in BUSES:
            keypads = (self.folder / KEYPADS.format(bus=bus), bus, CONTROL_PORTS[bus], UNITS, seed)
            started(self.machine, *meddling, "keypad", *keypads, log=log)
        port = (self.folder / "stty.jsonl", CABLE, self.link(CABLE), seed)
        started(self.machine, *meddling, "stty", *port, log=log)

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

    def configure(self, device: Device) -> None:
        """Write its lineside.toml."""
        self.folder.mkdir()
        units = "".join(f'[[bus.unit]]\nid = {unit}\nname = "Unit {unit}"\n' for unit in range(1, UNITS + 1))
        ports = {LINE: f"socket://{device.machine.address}:{DEVICE_PORT}", CABLE: device.link(CABLE)}
        self.config.write_text(
            f'[site]\nname = "Campaign"\n[server]\nhost = "{self.machine.address}"\nport = {SERVER_PORT}\n'
            'data = "data"\n'
            + "".join(
                f'[[bus]]\nname = "{bus}"\nport = "{port}"\nturnaround_ms = {TURNAROUND_MS}\n{units}'
                for bus, port in ports.items()
            )
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
