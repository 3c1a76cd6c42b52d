"""Faults on the floor: cable pulled, port taken, worker stopped, a command too late."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
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


@dataclass
class Plant(Dashboard):
    """``first_event``: of the test, on a line that several tests use one after the other."""

    first_event: int = 0


@pytest.fixture(scope="module")
def one_plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with dashboard(tmp_path_factory.mktemp("plant"), [Unit(1), Unit(2)]) as made:
        yield Plant(**vars(made))


@pytest.fixture
def plant(one_plant: Plant) -> Plant:
    """Units as they come from the factory, but for the speed of the first, read, and without limits."""
    one_plant.bus("PUT", "/units/1/limits", {}, "engineer").raise_for_status()
    for unit in one_plant.cable.units.values():
        vars(unit).update(vars(Unit(unit.address)))
    one_plant.cable.units[1].commanded = one_plant.cable.units[1].actual = 1000
    one_plant.see(
        1, "at its speed", lambda shown: shown["link"] == "online" and shown["commanded_raw"] == 1000
    )
    one_plant.first_event = one_plant.call("GET", "/events?limit=1").json()["events"][0]["id"] + 1
    return one_plant


def speed(plant: Dashboard, unit: int, raw: int, **body: Any) -> Any:
    """Set a unit's speed at once."""
    return plant.bus("POST", f"/units/{unit}/speed", {"raw": raw, "execute": True, **body})


@contextmanager
def stopped(plant: Dashboard) -> Iterator[None]:
    """The worker's process stands still (SIGSTOP) and goes on at the end."""
    (worker,) = plant.workers()
    os.kill(worker, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(worker, signal.SIGCONT)


def test_a_pulled_cable_closes_the_bus_and_nothing_is_sent_when_it_is_back(plant: Plant) -> None:
    plant.cable.pull()
    bus = eventually(lambda: (shown := plant.line())["link"] == "closed" and shown, "the bus closed")
    assert bus["link_cause"]
    assert {unit["link"] for unit in bus["units"]} <= {"stale", "offline"}
    assert [unit["commanded_raw"] for unit in bus["units"]] == [1000, 0]
    refused = speed(plant, 1, 4000)
    assert refused.status_code == 503
    assert refused.json()["code"] == refused.json()["outcome"] == "bus_closed"
    plant.cable.plug()
    plant.see(1, "online again", lambda shown: shown["link"] == "online")
    assert plant.cable.units[1].writes == []
    assert plant.cable.units[1].commanded == 1000
    assert speed(plant, 1, 4000).status_code == 200


def test_a_stopped_worker_makes_everything_stale_and_sends_nothing_late(plant: Plant) -> None:
    """The word comes before the worker counts as gone; what it finds on waking is late."""
    with stopped(plant):
        problem = speed(plant, 1, 4321).json()
        plant.see(1, "stale", lambda shown: shown["link"] in ("stale", "offline"))
    assert problem["outcome"] == "unverified"
    assert "does not respond" in problem["detail"]
    _responds(plant, 1)
    assert plant.cable.units[1].commanded == 1000
    assert plant.cable.units[1].writes == []
    (event,) = _events(plant, "kind=command")
    assert event["outcome"] == "unverified"


def test_a_worker_stopped_between_two_tries_tries_no_more(plant: Plant) -> None:
    unit = plant.cable.units[1]
    unit.mute_on = {0x84}
    with ThreadPoolExecutor(1) as other:
        command = other.submit(speed, plant, 1, 1100)
        eventually(lambda: unit.writes, "the first try")
        with stopped(plant):
            tries = len(unit.writes)
            problem = command.result(60).json()
    assert problem["outcome"] == "unverified"
    _responds(plant, 1)
    assert len(unit.writes) == tries


@contextmanager
def another_program(plant: Plant, script: str) -> Iterator[subprocess.Popen[str]]:
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


def closed(plant: Plant, words: str) -> dict[str, Any]:
    """Wait until the bus is shown closed, with this among the reasons."""

    def look() -> dict[str, Any] | None:
        bus = plant.line()
        return bus if bus["link"] == "closed" and words in bus["link_cause"]["detail"] else None

    shown: dict[str, Any] = eventually(look, f"closed with {words!r}; it is {plant.line()}")
    return shown


def nothing_is_sent_and_it_comes_back(plant: Plant) -> None:
    """To be begun while the port is closed; ends when the line is read again."""
    for unit in (1, 2):
        plant.see(unit, "online again", lambda shown: shown["link"] == "online")
    assert [unit.writes for unit in plant.cable.units.values()] == [[], []], "nothing is sent late"
    assert plant.bus("POST", "/units/1/speed", {"raw": 1200}).status_code == 200


def refused_meanwhile(plant: Plant) -> None:
    """A write finds the bus closed."""
    response = plant.bus("POST", "/units/1/speed", {"raw": 4000})
    assert (response.status_code, response.json()["code"]) == (503, "bus_closed")


def test_a_port_that_is_claimed_while_it_is_open_and_when_the_worker_starts(plant: Plant) -> None:
    with another_program(plant, CLAIM) as other:
        closed(plant, f"(process {other.pid})")
        refused_meanwhile(plant)
        (worker,) = plant.workers()
        os.kill(worker, signal.SIGKILL)
        eventually(lambda: plant.workers() not in ([], [worker]), "another worker", within=START_S)
        closed(plant, f"(process {other.pid})")
        refused_meanwhile(plant)
    nothing_is_sent_and_it_comes_back(plant)


def _events(plant: Plant, query: str) -> list[dict[str, Any]]:
    """Those of the test, of one kind or unit."""
    found: list[dict[str, Any]] = plant.call("GET", f"/events?limit=200&bus=dry-end&{query}").json()["events"]
    return [event for event in found if event["id"] >= plant.first_event]


def _responds(plant: Dashboard, unit: int) -> None:
    """Until the unit was read three times more, so that what was to be sent before has been."""
    for _ in range(3):
        _reads_again(plant, unit)


def _reads_again(plant: Dashboard, unit: int) -> None:
    before = plant.unit(unit)["read_at"]
    plant.see(unit, "read again", lambda shown: shown["read_at"] != before)
