"""A bad line: every 200 response is true, checked against units that know nothing of the product."""

from __future__ import annotations

import os
import random
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import ACK, NAK, Cable, Unit, frame

UNITS = (1, 2, 3)
WRITES = 8
"""To each unit, of those that are sent at all: on a slow machine a unit that misses responses is offline for
a while."""
MAX_TRIES = 20 * WRITES
RATE = 0.05
"""Of each fault."""
DEAF_RATE = 0.2
"""The rate of the one fault that only a read-back detects."""
WRITTEN = (0x84, 0x86, 0x87)
STRANGER = 99
LATE_S = 0.4
"""More than the turnaround that the bus allows."""


class BadCable(Cable):
    """Once ``bad``, every fault strikes at its rate, in an order that is the same in each run."""

    bad = False

    def __init__(self, path: Path, units: list[Unit]) -> None:
        super().__init__(path, units)
        self._dice = random.Random(11)

    def _strikes(self, rate: float = RATE) -> bool:
        return self.bad and self._dice.random() < rate

    def _respond(self, master: int, body: bytes) -> None:
        if self._strikes():
            return  # the request is lost
        if body[0] in self.units and self._strikes():
            os.write(master, frame(bytes([body[0], NAK, 0x80])))  # refused, as in LOCAL
            return
        if body[0] in self.units and body[1] in WRITTEN and self._strikes(DEAF_RATE):
            os.write(master, frame(bytes([body[0], ACK])))  # acknowledged, and nothing done
            return
        with self.lock:
            replies = [unit.respond(body) for unit in self.units.values()]
        for reply in replies:
            if reply is not None:
                time.sleep(0.002)
                os.write(master, self._spoilt(reply))

    def _spoilt(self, reply: bytes) -> bytes:
        if self._strikes():
            reply = b""  # lost
        if self._strikes():
            reply = reply[: len(reply) // 2]
        if self._strikes():
            reply = reply[:4] + bytes(byte ^ 0x04 for byte in reply[4:5]) + reply[5:]
        if self._strikes():
            reply += reply
        if self._strikes():
            reply = frame(bytes([STRANGER, ACK])) + reply
        if self._strikes():
            time.sleep(LATE_S)
        return reply


def test_verified_on_a_bad_line_is_true(tmp_path: Path) -> None:
    with dashboard(tmp_path, [Unit(number) for number in UNITS], cable_of=BadCable) as plant:
        assert isinstance(plant.cable, BadCable)
        plant.cable.bad = True
        with ThreadPoolExecutor(len(UNITS)) as people:
            result = [each for some in people.map(lambda unit: _play(plant, unit), UNITS) for each in some]
        plant.cable.bad = False
    outcomes = Counter(outcome for outcome, _ in result)
    assert [complaint for _, complaint in result if complaint] == []
    assert outcomes["verified"] > (len(result) - outcomes["not_sent"]) / 4, outcomes
    assert outcomes.keys() <= {"verified", "unverified", "refused", "not_sent"}


def _play(plant: Dashboard, number: int) -> list[tuple[str, str]]:
    """One write after the other to one unit; what came of each, and what is wrong with that."""
    dice = random.Random(number)
    result: list[tuple[str, str]] = []
    while sum(outcome != "not_sent" for outcome, _ in result) < WRITES and len(result) < MAX_TRIES:
        result.append(_write(plant, plant.cable.units[number], 1000 + len(result), dice))
    return result


def _write(plant: Dashboard, unit: Unit, raw: int, dice: random.Random) -> tuple[str, str]:
    unit.writes.clear()
    path, body, command, holds = _command(unit, raw, dice)
    method = "POST" if path == "speed" else "PUT"
    result: Any = plant.bus(method, f"/units/{unit.address}/{path}", body).json()
    acted = any(entry[0] == command for entry in unit.writes)
    outcome = result["outcome"]
    if outcome == "verified" and not holds():
        return outcome, f"{path} {body}: verified, and the unit does not hold it"
    if outcome in ("refused", "not_sent") and acted:
        return outcome, f"{path} {body}: {outcome}, and the unit acted"
    return outcome, ""


def _command(unit: Unit, raw: int, dice: random.Random) -> Any:
    """Path, body, command, and whether the unit holds it."""
    which = dice.randrange(3)
    if which == 0:
        return "speed", {"raw": raw, "timeout_s": 5}, 0x84, lambda: unit.commanded == raw
    if which == 1:
        return "parameters/9", {"raw": raw, "timeout_s": 5}, 0x86, lambda: unit.values[9] == raw
    output, on = dice.randrange(1, 7), dice.random() < 0.5
    return (
        f"outputs/{output}",
        {"on": on, "timeout_s": 5},
        0x87,
        lambda: bool(unit.outputs >> output - 1 & 1) == on,
    )
