"""Commands that reach the server late, or again with the key of another: none of them reaches a unit."""

from __future__ import annotations

from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.types import Receive, Scope, Send

from app.core.server.connections import ARRIVED_AT, BEGUN_AT
from app.core.web import arrival
from app.core.web.access import Person, Role
from app.core.web.arrival import SAFE_METHODS
from app.engineering.recipes.book import RecipeBook
from app.errors import Problem
from app.line.commands.service import CommandService
from app.line.live.bus_live import LiveState
from bus.contract import Result, WriteParameter
from tests.app.complete_app import House, commands_app
from tests.app.fake_worker import PlayedWorker, responding
from tests.app.played_commands import ANNA
from tests.app.played_commands import responding as responding_units
from tests.for_each import for_each

WRITES = [
    ("POST", "/units/1/speed", {"raw": 5}),
    ("POST", "/units/1/execute", None),
    ("POST", "/execute", None),
    ("POST", "/speeds", {"setpoints": {"1": {"raw": 5}}}),
    ("PUT", "/units/1/outputs/3", {"on": True}),
    ("PUT", "/units/1/analog-output", {"raw": 350}),
    ("PUT", "/units/1/parameters/6", {"raw": 50}),
    ("POST", "/baud", {"baud": 4800, "confirm": True}),
]
LATE_S = 3.5


def sent(seconds_ago: float, zone: timezone = UTC) -> dict[str, str]:
    """The header of a program that made its request so long ago."""
    return {"Lineside-Sent-At": (datetime.now(zone) - timedelta(seconds=seconds_ago)).isoformat()}


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[House]:
    async with commands_app(tmp_path) as built:
        yield built


@pytest.fixture
async def worker(site: House) -> PlayedWorker:
    """Every unit takes everything."""
    played = await site.worker()
    played.play = responding("verified", read_back=1)
    return played


@pytest.mark.parametrize(("method", "path", "body"), [WRITES[0], WRITES[3], WRITES[6]])
async def test_a_write_with_an_old_time_is_not_sent(
    site: House, worker: PlayedWorker, method: str, path: str, body: Any
) -> None:
    response = await site.request(method, path, body, headers=sent(LATE_S))
    assert (response.status_code, response.json()["code"], response.json()["outcome"]) == (
        503,
        "not_sent",
        "not_sent",
    )
    assert "too late" in response.json()["detail"]
    assert worker.commands == []
    assert (await site.request(method, path, body, headers=sent(0))).status_code == 200
    assert len(worker.commands) == 1


@for_each(
    ("path", "body", "status"),
    [
        ("/units/1/speed", {"raw": 5, "timeout_s": 20}, 200),
        ("/units/1/speed?timeout_s=20", {"raw": 5}, 200),
        ("/units/1/speed?timeout_s=20", {"raw": 5, "timeout_s": 3}, 503),
        ("/units/1/speed", {"raw": 5, "timeout_s": 3}, 503),
    ],
)
@pytest.mark.usefixtures("worker")
async def test_its_own_time_decides(site: House, path: str, body: Any, status: int) -> None:
    assert (await site.request("POST", path, body, headers=sent(LATE_S))).status_code == status


async def test_the_time_that_is_left_counts_from_when_it_was_made(site: House, worker: PlayedWorker) -> None:
    made = datetime.now(UTC) - timedelta(seconds=LATE_S)
    headers = {"Lineside-Sent-At": made.isoformat()}
    await site.request("POST", "/units/1/speed", {"raw": 5, "timeout_s": 20}, headers=headers)
    assert worker.commands[0].deadline == pytest.approx(made.timestamp() + 20, abs=0.01)


@for_each(
    "value",
    [
        "",
        "now",
        "1764000000",
        "2026-11-21",
        "2026-11-21T03:12:00",
        "2026-13-21T03:12:00Z",
        "NaN",
        "\xff",
        "2026-11-22T03:12:00Z, 2026-11-22T03:12:00Z",
    ],
)
async def test_a_time_without_zone_is_refused(site: House, worker: PlayedWorker, value: str) -> None:
    headers = {"Lineside-Sent-At": value.encode("latin-1")}
    response = await site.http().post("/api/v1/buses/dry-end/units/1/speed", json={"raw": 5}, headers=headers)
    assert (response.status_code, response.json()["code"]) == (422, "invalid")
    assert worker.commands == []


@pytest.mark.parametrize(
    ("zone", "ahead_s", "status"),
    [(timezone(timedelta(hours=-9, minutes=-30)), 3, 200), (timezone(timedelta(hours=14)), 6, 422)],
)
async def test_a_clock_may_be_ahead_by_five_seconds(
    site: House, worker: PlayedWorker, zone: timezone, ahead_s: float, status: int
) -> None:
    response = await site.request("POST", "/units/1/speed", {"raw": 5}, headers=sent(-ahead_s, zone))
    assert response.status_code == status
    assert len(worker.commands) == (status == 200)
    if status == 422:
        assert response.json()["code"] == "invalid"


async def test_a_finished_command_gives_its_result_however_late_it_is_repeated(
    site: House, worker: PlayedWorker
) -> None:
    key = {"Idempotency-Key": "mine"}
    body = {"raw": 5}
    first = await site.request("POST", "/units/1/speed", body, headers=key | sent(0))
    again = await site.request("POST", "/units/1/speed", body, headers=key | sent(60))
    assert (again.status_code, again.text) == (200, first.text)
    assert len(worker.commands) == 1


@pytest.mark.usefixtures("worker")
async def test_a_late_one_leaves_its_key_free(site: House) -> None:
    key = {"Idempotency-Key": "mine"}
    assert (await site.request("POST", "/execute", headers=key | sent(60))).status_code == 503
    assert (await site.request("POST", "/execute", headers=key | sent(0))).status_code == 200


@pytest.mark.usefixtures("worker")
async def test_reading_is_never_late(site: House) -> None:
    for headers in (sent(60), {"Lineside-Sent-At": "whenever"}):
        assert (await site.request("GET", "/units/1", headers=headers)).status_code == 200
        assert (await site.request("GET", "/units/1/parameters", headers=headers)).status_code == 200


async def test_a_long_body_makes_no_write_late(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of parameter sets on a slow network: what counts is when it began to come."""
    browser = await house.signed_in(Role.ENGINEER)
    now = 5000.0
    monkeypatch.setattr(arrival, "monotonic_now", lambda: now)

    async def stamped(scope: Scope, receive: Receive, send: Send) -> None:
        scope["state"] = {ARRIVED_AT: now, BEGUN_AT: now}
        await house.app(scope, receive, send)

    async def slowly() -> AsyncIterator[bytes]:
        nonlocal now
        yield b'{"lowest": 5, '
        now += 60
        yield b'"highest": 50}'

    headers = {"Content-Type": "application/json"}
    path = "/api/v1/buses/dry-end/units/1/limits"
    gated = httpx.AsyncClient(
        transport=httpx.ASGITransport(stamped), base_url=browser.base_url, cookies=browser.cookies
    )
    assert (await gated.put(path, content=slowly(), headers=headers)).status_code == 200
    assert (await gated.put(path, content=b"{}", headers=headers | sent(LATE_S))).status_code == 503


PUBLIC = {"/login", "/login/panel", "/setup"}
"""Signing in changes nothing at a unit."""


async def test_of_every_route_that_writes(house: House) -> None:
    """A program that sends the time of its request, and a page that sends the time of the click."""
    browser = await house.signed_in(Role.ADMIN)
    responding_units(house.services[LiveState])
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Kraft 80", "", {1: 1100})
    routes = {(method, route.path) for route in house.app.routes for method in getattr(route, "methods", ())}
    writes = {(method, path) for method, path in routes if method not in SAFE_METHODS and path not in PUBLIC}
    assert len(writes) > 50
    in_time = []
    for method, path in sorted(writes):
        for headers in (sent(60), {"Lineside-Clicked-At": "1.0"}):
            url = _filled_in(path, recipe.id)
            response = await browser.request(method, url, json=BODIES.get(url, {}), headers=headers)
            if response.status_code != 503 or "too late" not in response.text:
                in_time.append((method, path, response.text))
    assert in_time == []


BODIES = {f"/api/v1/buses/dry-end{path}": body for _, path, body in WRITES}


def _filled_in(path: str, recipe: int) -> str:
    names = {"bus": "dry-end", "unit": "1", "unit:int": "1", "recipe_id": recipe}
    names |= {"number:int": "3" if "outputs" in path else "6"}
    for name, value in names.items():
        path = path.replace(f"{{{name}}}", f"{value}")
    return path


PROGRAM = Person("anna", Role.ENGINEER, "token")


def password(raw: int) -> WriteParameter:
    return WriteParameter(unit=1, number=21, raw=raw)


@pytest.mark.parametrize("restarts", [False, True])
async def test_another_password_with_the_same_key_is_not_verified(tmp_path: Path, restarts: bool) -> None:
    """The value of #21 was left out of what was compared after a restart: it was *verified*, unwritten."""
    async with commands_app(tmp_path) as site:
        worker = await site.worker()
        worker.play = responding("verified", read_back=1234)
        assert (await _send(site.commands, 1234)).outcome == "verified"
        commands = _restarted(site) if restarts else site.commands
        with pytest.raises(Problem) as refused:
            await _send(commands, 4321)
        assert (refused.value.status, refused.value.code) == (422, "invalid")
        again = await _send(commands, 1234)
        assert (again.outcome, again.read_back) == ("verified", None)
        assert [command.action for command in worker.commands] == [password(1234)]


async def _send(commands: CommandService, raw: int) -> Result:
    return await commands.send(PROGRAM, password(raw), id="mine")


def _restarted(site: House) -> CommandService:
    return site.commands_after_restart()
