"""A command: from the request to its first byte on the wire, and many units set as one."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import httpx

from benchmarks.tables import median, milliseconds, quantile, show
from bus.settings import Dialect, wire_seconds
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    ReadStatusRequest,
    Reply,
    Request,
    StageSpeedRequest,
    StatusReply,
    encode_reply,
    encode_request,
)
from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import Site, eventually, site

BAUD = 9600
COMMANDS = 150
MANY = 32
REPEATS = 5
SET_AND_EXECUTE = "84"
STAGE = "82"
PAUSE_S = 0.037
"""Between two commands; no multiple of a poll, so that they fall at any phase of one."""


def run() -> None:
    """Two tables."""
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), 8, line_options=("--no-script",), installed=True) as served,
    ):
        _show_commands(served)
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), MANY, line_options=("--no-script",), installed=True) as served,
    ):
        _show_many(served)


def _show_commands(served: Site) -> None:
    to_wire: list[float] = []
    to_result: list[float] = []
    with served.api("operator") as client:
        for number in range(COMMANDS):
            raw = 1100 + number
            since = _last_number(served)
            begun = time.monotonic()
            response = client.post(
                f"/buses/line/units/{number % 8 + 1}/speed", json={"raw": raw, "execute": True}
            )
            to_result.append(time.monotonic() - begun)
            assert response.json()["outcome"] == "verified", response.text
            to_wire.append(_first_came(served, since, SET_AND_EXECUTE)["at"] - begun)
            time.sleep(PAUSE_S)
    rows = [
        [
            "the wire itself: half a poll is in flight",
            milliseconds(_poll_s() / 2),
            milliseconds(_poll_s()),
        ],
        ["request → first byte of 84h on the wire", _middle(to_wire), _worst(to_wire)],
        ["request → result, read back", _middle(to_result), _worst(to_result)],
    ]
    show(f"{COMMANDS} speeds set by HTTP while 8 units are polled", ["", "median", "p99"], rows)


def _show_many(served: Site) -> None:
    rows = []
    least = _change_wire_s()
    with served.api("operator") as client:
        units = eventually(lambda: _known_units(client), "whether each unit follows", within=PROCEDURE_S)
        for turn in range(REPEATS):
            setpoints = {str(unit["id"]): {"raw": _near(unit) + turn} for unit in units}
            since = _last_number(served)
            response = client.post(
                "/buses/line/speeds", json={"setpoints": setpoints, "timeout_s": 30}, timeout=60
            )
            assert response.status_code == 200, response.json()["detail"]
            took = _took(served, since)
            rows.append([str(turn + 1), f"{took:.3f} s", f"{took / least:.3f}"])
    note = f"The wire alone needs {least:.3f} s: {MANY} stages acknowledged, one broadcast, {MANY} proofs."
    show(
        f"{MANY} units changed as one",
        ["change", "first stage → last proof", "÷ the wire's own time"],
        rows,
        note,
    )


def _known_units(client: httpx.Client) -> list[dict[str, Any]]:
    """Return all units once each has been read for whether it follows another by ratio; until then none."""
    found: list[dict[str, Any]] = client.get("/line").json()["buses"][0]["units"]
    return [] if any(unit["follower"] is None for unit in found) else found


def _near(unit: dict[str, Any]) -> int:
    """A setpoint that this unit takes: a ratio for one that follows."""
    return 10_000 if unit["follower"] else 1_100


def _took(served: Site, since: int) -> float:
    """From the host's first stage to the end of the last unit's proof."""
    begun: float = _first_came(served, since, STAGE)["at"]
    ended: float = _record(served, since, "sent")[-1]["at"]
    return ended - begun


def _change_wire_s() -> float:
    units = range(1, MANY + 1)
    stages = sum(_wire_s(StageSpeedRequest(unit, 1100), Ack(unit)) for unit in units)
    return stages + _wire_s(ExecuteSpeedRequest(0)) + sum(_poll_s(unit) for unit in units)


def _poll_s(unit: int = 1) -> float:
    return _wire_s(ReadStatusRequest(unit), StatusReply(unit, 1100, 1100, 128, 0xC0, 3))


def _wire_s(request: Request, *replies: Reply) -> float:
    dialect = Dialect()
    frames = [encode_request(request, dialect), *(encode_reply(reply, dialect) for reply in replies)]
    return wire_seconds(sum(map(len, frames)), BAUD)


def _record(served: Site, since: int, *kinds: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = served.line.remote.do("record", since=since, kinds=kinds)
    return found


def _last_number(served: Site) -> int:
    recent = _record(served, 0, "came")
    return int(recent[-1]["number"])


def _first_came(served: Site, since: int, command: str) -> dict[str, Any]:
    """The host's first frame of a command: ``10 02 UID CMD …``, where unit 16 is written twice."""
    for entry in _record(served, since, "came"):
        octets = entry["hex"].split()
        if command in octets[3:5]:
            return entry
    raise AssertionError(f"no {command}h came")


def _middle(times: list[float]) -> str:
    return milliseconds(median(times))


def _worst(times: list[float]) -> str:
    return milliseconds(quantile(times, 0.99))
