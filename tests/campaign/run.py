"""A campaign from its seed: start everything, let faults happen, stop, and leave the records to the checker.

``python -m tests.campaign.run FOLDER SEED FAULTS``.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tests.campaign.checker.records import CLIENTS, CONNECTIONS, FAULTS, lines
from tests.campaign.faults import SERVERS, Fault, schedule
from tests.campaign.network import Machine, Network
from tests.campaign.site import BUS, ROOT, UNITS, AppServer, Device, signal_all, started

PASSWORD = "collect house bakery stable"
QUIET_S = 15.0
"""After the last fault: what is open concludes."""
PATIENCE_S = 60.0
RESUME_S = 0.5
"""What a process that was halted takes to pass on what has come meanwhile."""


@dataclass
class Campaign:
    """One server, the device server of its units, and people."""

    folder: Path
    seed: int
    network: Network = field(init=False)
    device: Device = field(init=False)
    apps: dict[str, AppServer] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.network = Network([*sorted(SERVERS)[:1], "device", "people"])

    @property
    def store(self) -> str:
        """What the checker reads in the end."""
        return str(self.apps["app-1"].folder / "data" / "lineside.db")

    def run(self, count: int) -> int:
        """Run ``count`` faults; return the exit code of the checker."""
        with ExitStack() as opened:
            opened.enter_context(self.network)
            self._start()
            for fault in schedule(self.seed, count, frozenset(self.network.machines)):
                time.sleep(fault.after_s)
                self._inject(fault)
            time.sleep(QUIET_S)
            self.machine("people").signal(signal.SIGTERM)
            return self._judge()

    def machine(self, name: str) -> Machine:
        return self.network.machines[name]

    def _start(self) -> None:
        self.device = Device(self.folder, self.machine("device"))
        self.device.start(self.seed)
        for name in sorted(SERVERS)[:1]:
            server = self.apps[name] = AppServer(self.folder / name, self.machine(name))
            server.configure(self.machine("device"))
        first = self.apps["app-1"]
        first.command("user", "add", "admin", "--role", "admin", "--password-stdin", text=PASSWORD)
        token = first.command("token", "create", "people", "--role", "operator").split()[-1]
        for server in self.apps.values():
            server.start()
            server.wait_until_it_serves()
        urls = [server.url for server in self.apps.values()]
        clients = (sys.executable, "-m", "tests.campaign.clients", self.folder / CLIENTS, token, BUS, UNITS)
        started(self.machine("people"), *clients, *urls, log=self.folder / "people.log")
        self._wait_for_a_live_value()

    def _wait_for_a_live_value(self) -> None:
        end = time.monotonic() + PATIENCE_S
        while not any(row["kind"] == "live" for row in lines(self.folder / CLIENTS)):
            assert time.monotonic() < end, "no server shows a live value"
            time.sleep(0.2)

    def holder(self) -> str:
        """The machine that wrote to the device server last."""
        rows = list(lines(self.folder / CONNECTIONS.format(bus=BUS)))
        address = rows[-1]["peer"].partition(":")[0]
        return next(name for name, machine in self.network.machines.items() if machine.address == address)

    def _inject(self, fault: Fault) -> None:
        row = {"kind": "fault", "now": time.time(), "fault": asdict(fault), "holder": self.holder()}
        self._record(**row)
        begin, end = self._acts(fault)
        begun = time.time()
        begin()
        time.sleep(fault.lasts_s)
        if (fault.kind, fault.target) == ("stop", "device"):
            self._record(kind="device_halt", begin=begun, end=time.time() + RESUME_S)
        end()

    def _record(self, **row: object) -> None:
        with (self.folder / FAULTS).open("a") as log:
            log.write(json.dumps(row) + "\n")
        print(json.dumps(row), flush=True)

    def _acts(self, fault: Fault) -> tuple[Callable[[], object], Callable[[], object]]:
        """How the fault begins and how it ends."""
        name, other, network = fault.target, fault.other, self.network
        server, machine = self.apps.get(name), self.machine(name)
        match fault.kind:
            case "cut":
                return lambda: network.cut(name), lambda: network.join(name)
            case "separate":
                return lambda: network.separate(name, other), lambda: network.reunite(name, other)
            case "clock" if server:
                return lambda: server.set_clock(fault.step_s), lambda: server.set_clock(0.0)
            case "kill_worker" if server:
                return lambda: signal_all(server.workers(), signal.SIGKILL), lambda: None
            case "stop_worker" if server:
                stopped = server.workers()
                return (
                    lambda: signal_all(stopped, signal.SIGSTOP),
                    lambda: signal_all(stopped, signal.SIGCONT),
                )
            case "kill":
                return lambda: self._signal(machine, signal.SIGKILL), lambda: self._begin_again(machine)
            case _:
                return (
                    lambda: self._signal(machine, signal.SIGSTOP),
                    lambda: self._signal(machine, signal.SIGCONT),
                )

    def _signal(self, machine: Machine, number: signal.Signals) -> None:
        """Of the machine of the device server only the device server: the units go on."""
        if machine.name == "device":
            self.device.signal(number)
        else:
            machine.signal(number)

    def _begin_again(self, machine: Machine) -> None:
        if machine.name == "device":
            self.device.start_server()
        elif machine.name in self.apps:
            self.apps[machine.name].start()
            self.apps[machine.name].wait_until_it_serves()

    def _judge(self) -> int:
        checker = (sys.executable, "-m", "tests.campaign.checker", self.folder, self.store, BUS)
        inside = self.machine("people").inside
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.run([*inside, *map(str, checker)], env=environment).returncode


def main(folder: str, seed: str, count: str) -> int:
    """Exit with the code of the checker."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    with suppress(KeyboardInterrupt):
        return Campaign(place.resolve(), int(seed)).run(int(count))
    return 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
