"""A change that arrives again under its id: one command, one result, and nothing is noted a second time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.engineering.recipes.book import RecipeBook
from app.engineering.recipes.rules import Recipe
from bus.contract import BusLink, ExecuteAll, ExecuteSpeed, ParameterValue, SetLine, Staged, UnitLink
from bus.instants import unix_now
from tests.app.complete_app import House
from tests.app.fake_worker import until
from tests.app.played_commands import ANNA
from tests.app.played_line import BUS, PlayedLine, played_line

API = "/api/v1"
KEY = {"Idempotency-Key": "mine-1"}
Sends = Callable[[], Awaitable[httpx.Response]]


@pytest.fixture
async def line(house: House) -> PlayedLine:
    line = await played_line(house.services)
    for unit, memory in line.memory.items():
        values = [ParameterValue(unit, number, unix_now(), raw) for number, raw in memory.items()]
        line.live.buses[BUS].apply(values)
    return line


async def sent(line: PlayedLine, *sends: Sends) -> list[httpx.Response]:
    """The responses to requests at the same time, of which one command becomes verified."""
    before = len(line.held)
    waiting = [asyncio.create_task(each()) for each in sends]  # type: ignore[arg-type]
    await until(lambda: len(line.held) > before, "the command")
    line.end("verified")
    return await asyncio.gather(*waiting)


async def recipe_of(house: House, name: str, raw: int) -> Recipe:
    return await house.services[RecipeBook].save(ANNA, BUS, name, "", {1: raw})


async def loads(house: House) -> int:
    """The number of events that a recipe was loaded."""
    return sum("loaded" in event["what"] for event in await house.events("recipe"))


def lose(line: PlayedLine) -> None:
    """Now no unit could take a command."""
    for unit in line.memory:
        line.live.buses[BUS].apply([UnitLink(unit=unit, at=unix_now(), link="offline")])


async def test_a_recipe_is_loaded_once(house: House, line: PlayedLine) -> None:
    recipe, other = await recipe_of(house, "Kraft 80", 700), await recipe_of(house, "Board", 800)
    program = await house.program(Role.ENGINEER)

    async def load(of: Recipe = recipe, key: str = "mine-1") -> httpx.Response:
        headers = {"Idempotency-Key": key}
        return await program.post(f"{API}/recipes/{of.id}/load", json={"confirm": True}, headers=headers)

    first, second = await sent(line, load, load)
    assert (first.status_code, first.json()["outcome"], second.text) == (200, "verified", first.text)
    await sent(line, lambda: load(other, "mine-2"))
    assert await loads(house) == 2
    lose(line)
    again = await load()
    assert (again.status_code, again.text) == (200, first.text)
    assert [command.action for command in line.held] == [SetLine({1: 700}), SetLine({1: 800})]
    assert await loads(house) == 2
    loaded = house.services[RecipeBook].loaded(BUS)
    assert loaded is not None
    assert loaded.recipe.name == "Board", "the one that was loaded last"
    assert (await load(other)).status_code == 422, "the id is of another recipe"
    assert (await load(key="mine-3")).status_code == 409, "under a new id the line is judged as it is"


async def test_a_form_of_a_recipe_shows_its_result_again(house: House, line: PlayedLine) -> None:
    recipe, browser = await recipe_of(house, "Kraft 80", 700), await house.signed_in(Role.ENGINEER)
    form = {"id": "form-id-1", "reviewed_at": unix_now(), "raw-1": "700", "was-1": "0"}
    form["scale-1"] = "-"
    path = f"/recipes/{recipe.id}/load"
    await assert_one_command(line, lambda: post(browser, path, form), SetLine({1: 700}))
    assert await loads(house) == 1


@pytest.mark.parametrize(
    ("path", "action"), [("units/1/execute", ExecuteSpeed(unit=1)), ("execute", ExecuteAll())]
)
async def test_a_staged_speed_is_executed_once(
    house: House, line: PlayedLine, path: str, action: object
) -> None:
    program = await house.program(Role.OPERATOR)
    stage(line)

    async def execute() -> httpx.Response:
        return await program.post(f"{API}/buses/{BUS}/{path}", headers=KEY)

    first, second = await sent(line, execute, execute)
    lose(line)
    again = await execute()
    assert {each.text for each in (second, again)} == {first.text}
    assert (first.status_code, first.json()["id"]) == (200, "mine-1")
    assert [command.action for command in line.held] == [action]


async def test_a_form_of_execute_staged_shows_its_result_again(house: House, line: PlayedLine) -> None:
    browser = await house.signed_in(Role.OPERATOR)
    stage(line)
    form = {"id": "form-id-1", "reviewed_at": unix_now(), "raw": "500", "was": "0"}
    form["scale"] = "-"
    path = f"/units/{BUS}/1/execute"
    await assert_one_command(line, lambda: post(browser, path, form), ExecuteSpeed(unit=1))
    other = await post(browser, path, {**form, "id": "form-id-2"})
    assert (other.status_code, "staged" in other.text) == (409, True), "nothing is staged by now"


def stage(line: PlayedLine, raw: int | None = 500) -> None:
    line.live.buses[BUS].apply([Staged(unit=1, at=unix_now(), raw=raw)])


async def post(browser: httpx.AsyncClient, path: str, form: dict[str, Any]) -> httpx.Response:
    return await browser.post(path, data=form, headers={"hx-request": "true"})


async def assert_one_command(line: PlayedLine, send: Sends, action: object) -> None:
    """Of a form that is pressed twice, and arrives again once nothing is as it was reviewed."""
    first, second = await sent(line, send, send)
    stage(line, None)
    lose(line)
    line.live.buses[BUS].apply([BusLink(at=unix_now(), link="closed")])
    again = await send()
    assert [each.status_code for each in (first, second, again)] == [200, 200, 200], again.text
    assert all("verified" in each.text for each in (first, second, again))
    assert [command.action for command in line.held] == [action]
