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

from tests.campaign.checker.records import CLIENTS, FAULTS, lines
from tests.campaign.faults import DEVICE, SERVER, Fault, schedule
from tests.campaign.network import Machine, Network
from tests.campaign.site import BUSES, ROOT, UNITS, AppServer, Device, signal_all, started

PEOPLE = "people"
PASSWORD = "collect house bakery stable"
QUIET_S = 40.0
"""After the last fault: what is open concludes, and every unit has to be live again."""
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
    server: AppServer = field(init=False)

    def __post_init__(self) -> None:
        self.network = Network([SERVER, DEVICE, PEOPLE])

    def run(self, count: int) -> int:
        """Run ``count`` faults; return the exit code of the checker."""
        with ExitStack() as opened:
            opened.enter_context(self.network)
            self._start()
            for fault in schedule(self.seed, count):
                time.sleep(fault.after_s)
                self._inject(fault)
            time.sleep(QUIET_S)
            self.machine(PEOPLE).signal(signal.SIGTERM)
            self._wait_for_the_last_look()
            return self._judge()

    def machine(self, name: str) -> Machine:
        return self.network.machines[name]

    def _start(self) -> None:
        self.device = Device(self.folder, self.machine(DEVICE))
        self.device.start(self.seed)
        server = self.server = AppServer(self.folder / SERVER, self.machine(SERVER))
        server.configure(self.device)
        server.command("user", "add", "admin", "--role", "admin", "--password-stdin", text=PASSWORD)
        token = server.command("token", "create", "people", "--role", "operator").split()[-1]
        server.start()
        server.wait_until_it_serves()
        clients = (sys.executable, "-m", "tests.campaign.clients", self.folder / CLIENTS, token, UNITS)
        for bus in BUSES:
            log = self.folder / f"people-{bus}.log"
            started(self.machine(PEOPLE), *clients, bus, server.url, self.seed, log=log)
        self._wait_for_live_values()
        self.device.meddle(self.seed)

    def _wait_for_live_values(self) -> None:
        end = time.monotonic() + PATIENCE_S
        while {row["bus"] for row in lines(self.folder / CLIENTS) if row["kind"] == "live"} != {*BUSES}:
            assert time.monotonic() < end, "the server shows no live value of a bus"
            time.sleep(0.2)

    def _wait_for_the_last_look(self) -> None:
        """At their end the clients read what is stored."""
        end = time.monotonic() + PATIENCE_S
        while self.machine(PEOPLE).processes():
            assert time.monotonic() < end, "the clients do not end"
            time.sleep(0.2)

    def _inject(self, fault: Fault) -> None:
        begin, end = self._acts(fault)
        began = time.time()
        begin()
        time.sleep(fault.lasts_s)
        if (fault.kind, fault.target) == ("stop", DEVICE):
            self._record(kind="device_halt", begin=began, end=time.time() + RESUME_S)
        end()
        self._record(kind="fault", began=began, ended=time.time(), fault=asdict(fault))

    def _record(self, **row: object) -> None:
        with (self.folder / FAULTS).open("a") as log:
            log.write(json.dumps(row) + "\n")
        print(json.dumps(row), flush=True)

    def _acts(self, fault: Fault) -> tuple[Callable[[], object], Callable[[], object]]:
        """How the fault begins and how it ends."""
        name, network, server = fault.target, self.network, self.server
        machine = self.machine(name)
        match fault.kind:
            case "cut":
                return lambda: network.cut(name), lambda: network.join(name)
            case "separate":
                return lambda: network.separate(name, DEVICE), lambda: network.reunite(name, DEVICE)
            case "clock":
                return lambda: server.set_clock(fault.step_s), lambda: server.set_clock(0.0)
            case "kill_worker":
                return lambda: signal_all(server.workers(), signal.SIGKILL), lambda: None
            case "stop_worker":
                stopped = server.workers()
                return (
                    lambda: signal_all(stopped, signal.SIGSTOP),
                    lambda: signal_all(stopped, signal.SIGCONT),
                )
            case "kill":
                return lambda: self._signal(machine, signal.SIGKILL), lambda: self._begin_again(name)
            case "stop":
                return (
                    lambda: self._signal(machine, signal.SIGSTOP),
                    lambda: self._signal(machine, signal.SIGCONT),
                )

    def _signal(self, machine: Machine, number: signal.Signals) -> None:
        """Of the machine of the device server only the device server: the units go on."""
        if machine.name == DEVICE:
            self.device.signal(number)
        else:
            machine.signal(number)

    def _begin_again(self, name: str) -> None:
        if name == DEVICE:
            self.device.start_server()
        else:
            self.server.start()
            self.server.wait_until_it_serves()

    def _judge(self) -> int:
        store = self.server.folder / "data" / "lineside.db"
        checker = (sys.executable, "-m", "tests.campaign.checker", self.folder, store, *BUSES)
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.run([*map(str, checker)], env=environment).returncode


def main(folder: str, seed: str, count: str) -> int:
    """Exit with the code of the checker."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    with suppress(KeyboardInterrupt):
        return Campaign(place.resolve(), int(seed)).run(int(count))
    return 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
