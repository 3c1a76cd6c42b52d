"""The change tray on the pages: what may be added, what its review shows, and when nothing of it is sent."""

from __future__ import annotations

import re
import time
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.engineering.recipes.book import RecipeBook
from app.line.commands.safeguards import Safeguards
from app.line.live.bus_live import LiveState
from bus.contract import ParameterValue, Reading
from tests.app.complete_app import HOST, House, complete_app
from tests.app.played_commands import ANNA, HEALTHY, fresh, responding
from tests.for_each import for_each

OF_PAGE = {"HX-Request": "true", "Origin": f"http://{HOST}"}
ROW = re.compile(r'name="row" value="([^"]+)"')


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Two units at rest in REMOTE at 100.0 of 2000.0, and an engineer."""
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        yield house


def local(house: House, unit: int) -> None:
    """A unit is set to LOCAL at its keypad."""
    apply(house, Reading(unit, fresh(), 1000, 1000, 0, 0, HEALTHY))


def apply(house: House, *updates: Reading | ParameterValue) -> None:
    house.services[LiveState].buses["dry-end"].apply(list(updates))


async def post(
    house: House, path: str, client: httpx.AsyncClient | None = None, **form: str
) -> httpx.Response:
    return await (client or house.clients[0]).post(path, data=form, headers=OF_PAGE)


async def add(house: House, unit: int = 1, value: str = "150.0") -> httpx.Response:
    return await post(house, f"/units/dry-end/{unit}/tray/setpoint", value=value)


async def tray(house: House) -> httpx.Response:
    return await house.clients[0].get("/bus/dry-end/tray/review", headers=OF_PAGE)


async def rows(house: House) -> list[str]:
    """The changes in the review."""
    return ROW.findall((await tray(house)).text)


async def send(house: House, **form: str | list[str]) -> httpx.Response:
    form = {"id": "c" * 32, "reviewed_at": str(time.time()), "row": await rows(house), **form}
    return await house.clients[0].post("/bus/dry-end/tray/send", data=form, headers=OF_PAGE)


async def test_each_way_to_set_a_value_adds_to_the_tray(house: House) -> None:
    saved = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {2: 1200})
    ways = {
        "/units/dry-end/1/tray/setpoint": {"value": "150.0"},
        "/units/dry-end/1/tray/outputs/3": {"on": "true"},
        "/units/dry-end/1/tray/analog-output": {"value": "7"},
        "/units/dry-end/1/tray/parameters/6": {"raw": "75", "scale": "-"},
        "/bus/dry-end/tray/setpoints": {"new-1": "", "new-2": "110.0"},
        f"/recipes/{saved.id}/tray": {},
        "/batch/dry-end/tray": {"number": "7", "unit-1": "5.0", "unit-2": "6.0"},
    }
    for path, form in ways.items():
        response = await post(house, path, **form)
        assert response.status_code == 200, (path, response.text)
        assert "1 change added to the tray" in response.text, path
    # 110.0 was replaced by the recipe; #7 of unit 1 is 5.0 already.
    assert await rows(house) == [
        "setpoint-1-0:1500:1000",
        "setpoint-2-0:1200:1000",
        "output-1-3:1:0",
        "analog-1-0:7:",
        "parameter-1-6:75:100",
        "parameter-2-7:60:50",
    ]
    strip = await house.clients[0].get("/tray/strip")
    assert "6 changes" in strip.text
    assert "2 units" in strip.text
    assert "/bus/dry-end/tray/review" in strip.text


@for_each(
    ("path", "form", "expected"),
    [
        ("/units/dry-end/1/tray/setpoint", {"value": "9000"}, "0.0 to 2000.0"),
        ("/units/dry-end/1/tray/analog-output", {"value": "x"}, "without decimals"),
        ("/units/dry-end/1/tray/parameters/21", {"raw": "12", "scale": "-"}, "a secret"),
        ("/units/dry-end/1/tray/parameters/17", {"raw": "12", "scale": "-"}, "(parameter 17)"),
        ("/bus/dry-end/tray/setpoints", {"new-1": ""}, "empty is not zero"),
        ("/batch/dry-end/tray", {"number": "7", "unit-1": "x"}, "Unwind: "),
    ],
)
async def test_what_can_never_be_sent_is_refused_in_place(
    house: House, path: str, form: dict[str, str], expected: str
) -> None:
    response = await post(house, path, **form)
    assert response.status_code in (409, 422)
    assert expected in response.text
    assert response.headers["HX-Retarget"]
    assert await rows(house) == []


async def test_a_recipe_that_is_not_for_these_units_is_refused_in_place(house: House) -> None:
    saved = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {2: 1200})
    apply(house, ParameterValue(unit=2, number=8, at=1.0, raw=1))
    response = await post(house, f"/recipes/{saved.id}/tray")
    assert "holds a speed" in response.text
    del house.services[LiveState].buses["dry-end"].units[2]
    response = await post(house, f"/recipes/{saved.id}/tray")
    assert "unit 2: not in the configuration" in response.text


async def test_each_role_adds_what_it_may_set(house: House) -> None:
    operator, viewer = await house.signed_in(Role.OPERATOR), await house.signed_in(Role.VIEWER)
    for path, form, allowed in (
        ("/units/dry-end/1/tray/setpoint", {"value": "150.0"}, True),
        ("/units/dry-end/1/tray/outputs/3", {"on": "true"}, True),
        ("/units/dry-end/1/tray/analog-output", {"value": "7"}, False),
        ("/units/dry-end/1/tray/parameters/6", {"raw": "75", "scale": "-"}, False),
        ("/batch/dry-end/tray", {"number": "7"}, False),
    ):
        assert (await post(house, path, operator, **form)).status_code == (200 if allowed else 403), path
        assert (await post(house, path, viewer, **form)).status_code == 403, path
    assert (await viewer.get("/tray")).status_code == 403
    assert 'id="tray"' not in (await viewer.get("/")).text
    assert await rows(house) == [], "each has an own tray"


async def test_a_unit_that_cannot_take_it_is_left_out_by_name_only(house: House) -> None:
    await add(house, 1)
    await add(house, 2)
    local(house, 2)
    review = await tray(house)
    assert "Leave out Nip" in review.text
    assert "Send 1 change" in review.text
    assert "Nip: not in REMOTE" in (await send(house)).text
    assert "every unit is left out" in (await send(house, **{"leave-out": ["1", "2"]})).text
    assert "differs from the review" in (await send(house, **{"leave-out": "x"})).text
    sent = await send(house, **{"leave-out": "2"})
    assert "left out: not in REMOTE" in sent.text
    assert [event["unit"] for event in await house.events("command")] == [1]
    assert await rows(house) == ["setpoint-1-0:1500:1000", "setpoint-2-0:1500:1000"], "there is no worker"
    local(house, 1)
    assert "No change can be sent now" in (await tray(house)).text


@for_each(
    ("form", "expected"),
    [
        ({"reviewed_at": "1"}, "expired"),
        ({"row": ["setpoint-1-0:1500:990"]}, "Unwind, Setpoint: the value has changed since the review"),
        ({"row": ["setpoint-1-0:1400:1000"]}, "tray has changed since the review"),
        ({"row": []}, "tray has changed since the review"),
        ({"row": ["setpoint-1-0:x:1000"]}, "differs from the review"),
        ({"row": ["valve-1-0:1:1"]}, "differs from the review"),
    ],
)
async def test_nothing_is_sent_but_what_was_reviewed(
    house: House, form: dict[str, str | list[str]], expected: str
) -> None:
    await add(house)
    response = await send(house, **form)
    assert expected in response.text
    assert 'data-review-done="bad"' in response.text
    assert await house.events("command") == []
    assert await rows(house) == ["setpoint-1-0:1500:1000"]


async def test_a_dangerous_parameter_needs_its_word(house: House) -> None:
    await post(house, "/units/dry-end/1/tray/parameters/18", raw="48", scale="-")
    assert 'data-typed="WRITE"' in (await tray(house)).text
    assert "word was not typed" in (await send(house)).text
    assert await house.events("command") == []


async def test_to_look_at_a_tray_and_its_review_prolongs_no_control(tmp_path: Path) -> None:
    async with complete_app(tmp_path, control=True) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        await post(house, "/bus/dry-end/control", do="take")
        await add(house)
        guards = house.services.buses["dry-end"][Safeguards]
        held = [guards.holding()]
        for path in (
            "/tray",
            "/bus/dry-end/tray/review",
            "/tray/strip",
            "/setpoints",
            "/units/dry-end/1",
            "/",
        ):
            response = await house.clients[0].get(path, headers=OF_PAGE)
            assert response.status_code in (200, 404), path
            held.append(guards.holding())
        assert held[0] is not None
        assert set(held) == {held[0]}


async def test_the_tray_stays_while_another_has_control(tmp_path: Path) -> None:
    async with complete_app(tmp_path, control=True) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        ben = await house.signed_in(Role.OPERATOR, "ben")
        await post(house, "/bus/dry-end/control", ben, do="take")
        await add(house)
        assert 'data-control-offer="dry-end"' in (await tray(house)).text
        response = await send(house, row=["setpoint-1-0:1500:1000"])
        assert "ben has control of this line" in response.text
        assert "1 change" in (await house.clients[0].get("/tray/strip")).text
        await post(house, "/bus/dry-end/control", ben, do="release")
        await post(house, "/bus/dry-end/control", do="take")
        assert await rows(house) == ["setpoint-1-0:1500:1000"]


async def test_changes_are_removed_one_by_one_or_all(house: House) -> None:
    for unit in (1, 2):
        await add(house, unit)
    review = await post(house, "/bus/dry-end/tray/remove", place="setpoint-1-0")
    assert ROW.findall(review.text) == ["setpoint-2-0:1500:1000"]
    await post(house, "/bus/dry-end/tray/remove", place="setpoint-9-0")
    assert await rows(house) == ["setpoint-2-0:1500:1000"]
    emptied = await post(house, "/bus/dry-end/tray/remove")
    assert "The change tray is empty" in emptied.text


async def test_a_browser_without_scripts_has_pages(house: House) -> None:
    await add(house)
    browser = house.clients[0]
    page = await browser.get("/tray")
    assert 'formaction="/bus/dry-end/tray/remove"' in page.text
    review = await browser.get("/bus/dry-end/tray/review")
    assert "<!doctype html>" in review.text
    assert 'method="post" action="/bus/dry-end/tray/send"' in review.text
    form = {"id": "c" * 32, "reviewed_at": str(time.time()), "row": ROW.findall(review.text)}
    done = await browser.post("/bus/dry-end/tray/send", data=form)
    assert "<!doctype html>" in done.text
    assert "0 of 1 change made" in done.text
    refused = await browser.post("/bus/dry-end/tray/send", data={**form, "reviewed_at": "1"})
    assert refused.status_code == 409
    removed = await browser.post("/bus/dry-end/tray/remove", data={"place": "setpoint-1-0"})
    assert (removed.status_code, removed.headers["location"]) == (303, "/tray")
    assert "The change tray is empty" in (await browser.get("/tray")).text
