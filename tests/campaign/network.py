"""Machines of a campaign: network namespaces on a bridge, which faults cut off or separate. Root only."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SUBNET = "10.77.0"
PRIORITY = "-10"
NOWHERE = "02:00:00:00:00:01"
"""A hardware address that no machine has: what is sent there is lost without a notice."""


def unusable() -> str:
    """Why namespaces cannot be made here; empty where they can."""
    if os.geteuid() != 0:
        return "only root makes network namespaces"
    if shutil.which("ip") is None:
        return "iproute2 is not installed"
    made = subprocess.run(["ip", "netns", "add", "lineside-probe"], capture_output=True, text=True)
    subprocess.run(["ip", "netns", "del", "lineside-probe"], capture_output=True)
    return "" if made.returncode == 0 else f"no network namespaces: {made.stderr.strip()}"


def call(*words: object, **options: Any) -> str:
    """The output of a command that must succeed."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{' '.join(map(str, words))}: {done.stderr}{done.stdout}"
    return done.stdout


@dataclass(frozen=True)
class Machine:
    """A network namespace with one address."""

    prefix: str
    name: str
    number: int

    @property
    def namespace(self) -> str:
        return f"{self.prefix}-{self.name}"

    @property
    def address(self) -> str:
        return f"{SUBNET}.{self.number}"

    @property
    def inside(self) -> list[str]:
        """What a command line begins with that runs on this machine."""
        return ["ip", "netns", "exec", self.namespace]

    def processes(self) -> list[int]:
        """Everything that runs on it."""
        return [int(word) for word in call("ip", "netns", "pids", self.namespace).split()]

    def signal(self, number: int) -> None:
        """Everything that runs on it gets the signal."""
        for process in self.processes():
            with suppress(ProcessLookupError):
                os.kill(process, number)

    def start(self, *words: object, log: Path, **options: Any) -> subprocess.Popen[bytes]:
        """Start a program on it; its output is appended to ``log``. It goes before other programs of this
        computer, as on a separate one."""
        command = ["nice", "-n", PRIORITY, *self.inside, *map(str, words)]
        with log.open("ab") as output:
            return subprocess.Popen(command, stdout=output, stderr=output, **options)


@dataclass
class Network:
    """Machines on a bridge. ``with``: they are there; afterwards nothing is left of them."""

    names: Sequence[str]
    prefix: str = field(default_factory=lambda: f"ls{os.getpid() % 10000}")
    machines: dict[str, Machine] = field(default_factory=dict)

    @property
    def switch(self) -> str:
        return f"{self.prefix}-switch"

    def __enter__(self) -> Network:
        call("ip", "netns", "add", self.switch)
        call("ip", "-n", self.switch, "link", "add", "bridge", "type", "bridge")
        call("ip", "-n", self.switch, "link", "set", "bridge", "up")
        for number, name in enumerate(self.names, start=11):
            self._add(Machine(self.prefix, name, number))
        return self

    def __exit__(self, *_: object) -> None:
        for machine in self.machines.values():
            machine.signal(signal.SIGCONT)
            machine.signal(signal.SIGKILL)
            call("ip", "netns", "del", machine.namespace)
        call("ip", "netns", "del", self.switch)

    def _add(self, machine: Machine) -> None:
        name, there = machine.namespace, f"p{machine.number}"
        call("ip", "netns", "add", name)
        made = ("link", "add", "eth0", "netns", name, "type", "veth", "peer", "name", there)
        call("ip", "-n", self.switch, *made)
        call("ip", "-n", self.switch, "link", "set", there, "master", "bridge", "up")
        call("ip", "-n", name, "address", "add", f"{machine.address}/24", "dev", "eth0")
        for device in ("lo", "eth0"):
            call("ip", "-n", name, "link", "set", device, "up")
        self.machines[machine.name] = machine

    def cut(self, name: str) -> None:
        """Pull the cable of a machine."""
        call("ip", "-n", self.switch, "link", "set", f"p{self.machines[name].number}", "down")

    def join(self, name: str) -> None:
        """Plug the cable of a machine."""
        call("ip", "-n", self.switch, "link", "set", f"p{self.machines[name].number}", "up")

    def separate(self, one: str, other: str) -> None:
        """Lose everything that passes between two machines, in silence."""
        for here, there in ((one, other), (other, one)):
            words = ("neigh", "replace", self.machines[there].address, "lladdr", NOWHERE, "dev", "eth0")
            call("ip", "-n", self.machines[here].namespace, *words, "nud", "permanent")

    def reunite(self, one: str, other: str) -> None:
        """End what ``separate`` began."""
        for here, there in ((one, other), (other, one)):
            words = ("neigh", "del", self.machines[there].address, "dev", "eth0")
            call("ip", "-n", self.machines[here].namespace, *words)
