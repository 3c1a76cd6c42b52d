"""Another program wants the port, and the adapter comes back under another name."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.e2e.limits import START_S
from tests.e2e.site import end, eventually
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Unit

CLAIM = """
import fcntl, os, sys, termios
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.ioctl(port, termios.TIOCEXCL)
print("held", flush=True)
sys.stdin.read()
"""
"""As programs do that do not check, while the worker has it open. The other end of the cable has the terminal
open, so the claim outlives the program.
"""


@pytest.fixture(scope="module")
def one_plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    with dashboard(tmp_path_factory.mktemp("plant"), [Unit(1), Unit(2)]) as made:
        yield made


@pytest.fixture
def plant(one_plant: Dashboard) -> Dashboard:
    for unit in one_plant.cable.units.values():
        unit.writes.clear()
    return one_plant


@contextmanager
def another_program(plant: Dashboard, script: str) -> Iterator[subprocess.Popen[str]]:
    """It runs; whether it has the port yet is another matter."""
    process = subprocess.Popen(
        [sys.executable, "-c", script, plant.cable.port],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        assert process.stdin is not None
        process.stdin.close()
        process.stdin = None
        process.wait()
        end(process)


def closed(plant: Dashboard, words: str) -> dict[str, Any]:
    """Wait until the bus is shown closed, with this among the reasons."""

    def look() -> dict[str, Any] | None:
        bus = plant.line()
        return bus if bus["link"] == "closed" and words in bus["link_cause"]["detail"] else None

    shown: dict[str, Any] = eventually(look, f"closed with {words!r}; it is {plant.line()}")
    return shown


def nothing_is_sent_and_it_comes_back(plant: Dashboard) -> None:
    """To be begun while the port is closed; ends when the line is read again."""
    for unit in (1, 2):
        plant.see(unit, "online again", lambda shown: shown["link"] == "online")
    assert [unit.writes for unit in plant.cable.units.values()] == [[], []], "nothing is sent late"
    assert plant.bus("POST", "/units/1/speed", {"raw": 1200}).status_code == 200


def refused_meanwhile(plant: Dashboard) -> None:
    """A write finds the bus closed."""
    response = plant.bus("POST", "/units/1/speed", {"raw": 4000})
    assert (response.status_code, response.json()["code"]) == (503, "bus_closed")


def test_a_port_that_is_claimed_while_it_is_open_and_when_the_worker_starts(plant: Dashboard) -> None:
    with another_program(plant, CLAIM) as other:
        closed(plant, f"(process {other.pid})")
        refused_meanwhile(plant)
        (worker,) = plant.workers()
        os.kill(worker, signal.SIGKILL)
        eventually(lambda: plant.workers() not in ([], [worker]), "another worker", within=START_S)
        closed(plant, f"(process {other.pid})")
        refused_meanwhile(plant)
    nothing_is_sent_and_it_comes_back(plant)
