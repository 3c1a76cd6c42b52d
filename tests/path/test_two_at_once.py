"""Two users set all units at once: one change after the other, never a mixture."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from pathlib import Path
from typing import Any

from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Cable, Unit

STAGE, EXECUTE = 0x82, 0x83
UNITS = (1, 2, 3)
PASSES = 2


class Listening(Cable):
    """Keeps every frame that stages or executes, in the order of the wire."""

    def __init__(self, path: Path, units: list[Unit]) -> None:
        super().__init__(path, units)
        self.received: list[bytes] = []
        self.begun = threading.Event()

    def _respond(self, master: int, body: bytes) -> None:
        if body[1] in (STAGE, EXECUTE):
            self.received.append(body)
            self.begun.set()
        super()._respond(master, body)


def test_of_two_changes_of_the_line_one_waits_for_the_other(tmp_path: Path) -> None:
    units = [Unit(number, commanded=1000, actual=1000) for number in UNITS]
    with dashboard(tmp_path, units, cable_of=Listening) as plant, ThreadPoolExecutor(2) as people:
        cable = plant.cable
        assert isinstance(cable, Listening)
        for base in range(1000, 1000 + 100 * PASSES, 100):
            cable.begun.clear()
            cable.received.clear()
            first = people.submit(_set, plant, base, "operator")
            cable.begun.wait(60)
            second = people.submit(_set, plant, base + 50, "engineer")
            responses = [first.result(), second.result()]
            taken = [
                base + 50 * place for place, response in enumerate(responses) if response.status_code == 200
            ]
            assert taken, [response.text for response in responses]
            changes = _changes(cable.received)
            assert sorted(change for change, _ in changes) == taken
            assert all(staged == set(UNITS) for _, staged in changes)
            assert {unit.commanded - number for number, unit in cable.units.items()} == {changes[-1][0]}
            for response in responses:
                if response.status_code != 200:
                    assert response.json()["code"] == "not_sent", response.text


def _set(plant: Dashboard, base: int, role: str) -> Any:
    setpoints = {str(number): {"raw": base + number} for number in UNITS}
    return plant.bus("POST", "/speeds", {"setpoints": setpoints, "timeout_s": 30}, role)


def _changes(received: list[bytes]) -> list[tuple[int, set[int]]]:
    """Of each change up to its broadcast: what it set beyond a unit's number, and which units it staged."""
    changes = []
    for is_staging, frames in groupby(received, lambda body: body[1] == STAGE):
        if is_staging:
            staged = {body[0]: int.from_bytes(body[2:], "big") - body[0] for body in frames}
            (base,) = set(staged.values())
            changes.append((base, set(staged)))
        else:
            assert {body[0] for body in frames} <= {0}, "executed by the broadcast alone"
    return changes
