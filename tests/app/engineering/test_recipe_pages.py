"""Loading a recipe on its page: only what was reviewed, and only while that holds."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.admission.access import Role
from app.engineering.recipes.book import RecipeBook
from app.line.live.bus_live import LiveState
from bus.contract import ParameterValue
from tests.app.complete_app import House, complete_app
from tests.app.played_commands import ANNA


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


async def load(client: httpx.AsyncClient, **changed: str) -> httpx.Response:
    form = {"id": "c" * 32, "reviewed_at": str(time.time()), "raw-1": "700", "was-1": ""}
    form |= {"scale-1": "8:0,3:1", **changed}
    return await client.post("/recipes/1/load", data=form, headers={"Origin": str(client.base_url)})


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"reviewed_at": "1"}, "expired"),
        ({"reviewed_at": "nan"}, "expired"),
        ({"was-1": "690"}, "changed since the review"),
        ({"raw-1": "710"}, "differs from the review"),
        ({"raw-1": ""}, "differs from the review"),
        ({}, "cannot be loaded now"),
        ({"leave-out": "x"}, "differs from the review"),
        ({"leave-out": "1"}, "every unit of Board is left out"),
    ],
)
async def test_only_what_was_reviewed_is_loaded(house: House, changed: dict[str, str], expected: str) -> None:
    unit_1 = [ParameterValue(unit=1, number=number, at=1, raw=raw) for number, raw in ((3, 1), (8, 0))]
    house.services[LiveState].buses["dry-end"].apply(list(unit_1))
    await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    response = await load(await house.signed_in(Role.OPERATOR), **changed)
    assert expected in response.text
    assert 'data-review-done="bad"' in response.text


async def test_the_name_of_a_unit_is_no_word_of_the_page(house: House) -> None:
    unit = house.services[LiveState].buses["dry-end"].units[1]
    house.services[LiveState].buses["dry-end"].apply([ParameterValue(unit=1, number=8, at=1, raw=0)])
    object.__setattr__(unit.settings, "name", "Line")
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    viewer = await house.signed_in(Role.VIEWER)
    page = await viewer.get(f"/recipes/{recipe.id}", headers={"Accept-Language": "de"})
    assert '<th scope="row">Line</th>' in page.text


async def test_programs_see_what_a_load_would_do_and_what_departed(house: House) -> None:
    bus = house.services[LiveState].buses["dry-end"]
    bus.apply([ParameterValue(unit=1, number=number, at=1, raw=raw) for number, raw in ((3, 1), (8, 0))])
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    viewer = await house.signed_in(Role.VIEWER)
    run = (await viewer.get(f"/api/v1/recipes/{recipe.id}/dry-run")).json()
    [step] = run["units"]
    assert (run["loadable"], step["id"], step["name"], step["raw"], step["new"]) == (
        False,
        1,
        "Unwind",
        700,
        "70.0",
    )
    assert (step["old"], step["ramp_s"], step["obstacle"]["code"]) == (None, None, "obstacle_no_link")
    assert step["effect"]["detail"].startswith("becomes 70.0")
    assert not {"measure", "risks"} & step.keys()
    await house.services[RecipeBook].store.mark_loaded("dry-end", recipe.id, "anna", time.time())
    await house.services[RecipeBook].load_marks()
    del bus.units[1]
    [departed] = (await viewer.get("/api/v1/buses/dry-end/recipe")).json()["departed"]
    assert (departed["id"], departed["name"], departed["recipe"]) == (1, "unit 1", "700")
    assert departed["now"]["code"] == "unit_not_configured"
