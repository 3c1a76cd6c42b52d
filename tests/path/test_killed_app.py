"""The app is killed (kill -9) in the middle of a change of the line: the old line or the complete new one."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from tests.e2e.limits import START_S
from tests.e2e.site import eventually
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Unit

OLD, NEW = [1000, 1000, 1000], [1010, 1020, 1030]
STAGE, EXECUTE = 0x82, 0x83


@dataclass
class Killer(Unit):
    """Kills ``victim`` when it receives a command for the first time, before it responds."""

    command: int = 0
    victim: list[int] = field(default_factory=list)

    def respond(self, body: bytes) -> bytes | None:
        """As any unit does."""
        reply = super().respond(body)
        if body[0] in (0, self.address) and body[1] == self.command and self.victim:
            os.kill(self.victim.pop(), signal.SIGKILL)
        return reply


@pytest.mark.parametrize(
    ("command", "complete"), [(STAGE, [OLD, NEW]), (EXECUTE, [NEW])], ids=["staged", "executed"]
)
def test_a_killed_app_leaves_a_complete_line(tmp_path: Path, command: int, complete: list[list[int]]) -> None:
    """Before the execute it is the old line, or the new one where the worker had done before it knew."""
    killer = Killer(2, commanded=1000, actual=1000, command=command)
    units = [Unit(1, commanded=1000, actual=1000), killer, Unit(3, commanded=1000, actual=1000)]
    with dashboard(tmp_path, units) as plant, ThreadPoolExecutor(1) as other:
        worker, server = _worker_and_server(plant)
        killer.victim.append(server)
        other.submit(_send, plant)
        eventually(lambda: _ended(worker), "the worker gone with its app", within=START_S)
        assert [unit.commanded for unit in units] in complete
        assert all(unit.staged in (None, unit.commanded) for unit in units), "and nothing waits to surprise"


def _send(plant: Dashboard) -> None:
    with suppress(httpx.HTTPError):
        plant.bus("POST", "/speeds", {"setpoints": {str(n): {"raw": raw} for n, raw in enumerate(NEW, 1)}})


def _worker_and_server(plant: Dashboard) -> tuple[int, int]:
    (worker,) = plant.workers()
    return worker, int(_status(worker)[1])


def _ended(process: int) -> bool:
    try:
        return _status(process)[0] == "Z"
    except OSError:
        return True


def _status(process: int) -> list[str]:
    """From the state on: of a process, its parent second (proc(5))."""
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
