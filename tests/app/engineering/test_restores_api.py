"""Restores over HTTP and by the page: what is chosen is what is written."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.admission.access import Role
from app.engineering.sets.restore_service import RestoreService
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.app.stage import until

PLANS = f"/api/v1/buses/{BUS}/units/2/restores"
DRIFTED = {6: 50, 7: 60, 20: 1216, 37: 9000, 27: 1}
"""What the set has; the unit has left it."""


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


@pytest.fixture
async def line(house: House) -> PlayedLine:
    return await played_line(house.services)


@pytest.fixture
async def client(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.ENGINEER)


@pytest.fixture
async def golden(client: httpx.AsyncClient, line: PlayedLine) -> int:
    """A set of the unit, golden; another is newer, and the unit has drifted since."""
    line.memory[2] |= DRIFTED
    number = int((await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [2]})).json()["id"])
    await client.post(f"/api/v1/sets/{number}/golden", json={"unit": 2})
    await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [1, 2]})
    line.memory[2] |= {6: 51, 7: 61, 20: 1000, 37: 9500, 27: 0}
    return number


async def plan(client: httpx.AsyncClient, golden: int, **chosen: Any) -> Any:
    response = await client.post(PLANS, json={"set": golden, **chosen})
    assert response.status_code == 201, response.text
    return response.json()


async def ended(house: House, client: httpx.AsyncClient, restore: str) -> Any:
    found = await house.services[RestoreService].find(restore)
    assert found is not None
    await until(lambda: found.state in ("equal", "different", "stopped"), "the end of the restore")
    return (await client.get(f"/api/v1/restores/{restore}")).json()


def selected(planned: Any) -> dict[int, bool]:
    return {row["number"]: row["selected"] for row in planned["rows"]}


async def test_a_plan_shows_which_rows_are_selected_and_why_not(
    client: httpx.AsyncClient, golden: int
) -> None:
    planned = await plan(client, golden)
    assert selected(planned) == {6: True, 7: True, 20: False, 37: False}
    setpoint = next(row for row in planned["rows"] if row["number"] == 20)
    assert (setpoint["reason_code"], setpoint["effect"]) == ("operating_value", "setpoint")
    assert (setpoint["present_raw"], setpoint["wanted_raw"]) == (1000, 1216)
    assert setpoint["reason"] == setpoint["warning"]
    assert setpoint["reason"]["detail"] == "Changes the machine's speed now"
    left = {row["number"]: (row["reason_code"], row["differs"]) for row in planned["left_out"]}
    assert left == {
        20: ("operating_value", True),
        27: ("dangerous", True),
        37: ("operating_value", True),
    }
    chosen = await plan(client, golden, include=[20], exclude=[6], ticked=[27])
    assert selected(chosen) == {6: False, 7: True, 20: True, 27: True, 37: False}


async def test_what_was_not_named_is_not_written_and_not_missed(
    house: House, client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    planned = await plan(client, golden)
    assert (await client.post(f"/api/v1/restores/{planned['id']}/start")).status_code == 202
    end = await ended(house, client, planned["id"])
    assert (end["state"], end["remaining"]) == ("equal", [])
    assert {number for _, number, _ in line.written} == {6, 7}
    assert {row["number"] for row in end["left_out"] if row["differs"]} == {20, 27, 37}


@pytest.mark.parametrize(
    ("chosen", "written"),
    [({}, {7, 20}), ({"include": []}, {7}), ({"exclude": []}, {6, 7, 20}), ({"exclude": [7]}, {6, 20})],
)
async def test_the_start_may_choose_other_rows(
    house: House,
    client: httpx.AsyncClient,
    line: PlayedLine,
    golden: int,
    chosen: dict[str, list[int]],
    written: set[int],
) -> None:
    planned = await plan(client, golden, include=[20], exclude=[6])
    await client.post(f"/api/v1/restores/{planned['id']}/start", json=chosen)
    assert (await ended(house, client, planned["id"]))["state"] == "equal"
    assert {number for _, number, _ in line.written} == written


@pytest.mark.parametrize(
    ("chosen", "status", "code"),
    [
        ({"include": [27]}, 409, "dangerous"),
        ({"include": [6], "exclude": [6]}, 422, "invalid"),
        ({"include": [41]}, 422, "invalid"),
        ({"include": [20, 20]}, 422, "invalid"),
        ({"includes": [20]}, 422, "invalid"),
    ],
)
async def test_a_choice_that_cannot_be_is_refused(
    client: httpx.AsyncClient, line: PlayedLine, golden: int, chosen: dict[str, Any], status: int, code: str
) -> None:
    refused = await client.post(PLANS, json={"set": golden, **chosen})
    assert (refused.status_code, refused.json()["code"]) == (status, code)
    planned = await plan(client, golden)
    refused = await client.post(f"/api/v1/restores/{planned['id']}/start", json=chosen)
    assert (refused.status_code, refused.json()["code"]) == (status, code)
    assert line.written == []


async def test_a_value_that_moved_since_the_plan_stops_it(
    house: House, client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    planned = await plan(client, golden)
    line.memory[2][7] = 62
    await client.post(f"/api/v1/restores/{planned['id']}/start")
    end = await ended(house, client, planned["id"])
    assert (end["state"], end["cause_code"], line.written) == ("stopped", "moved", [])
    assert {row["outcome"] for row in end["rows"]} == {"not_sent"}
    page = await client.get(f"/restores/{planned['id']}", headers={"accept-language": "de"})
    assert "der Regler hat sich seit dem Prüfen geändert" in page.text


async def test_the_page_selects_the_golden_set_and_writes_checked_rows(
    house: House, client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    page = (await client.get(f"/units/{BUS}/2/restore")).text
    assert re.findall(r'value="([^"]*)" selected', page) == [f"set:{golden}:2"]
    own, others = page.split('<optgroup label="Sets of other units', 1)
    assert own.count("<option") == 3
    assert "unit 1" in others
    review = await client.post(f"/units/{BUS}/2/restore", data={"source": f"set:{golden}:2"})
    path = review.headers["location"]
    page = (await client.get(path)).text
    assert re.findall(r'name="row" value="(\d+)" checked', page) == ["6", "7"]
    assert re.findall(r'name="row" value="(\d+)" aria', page) == ["20", "37"]
    for rows, words in (([], "no row was chosen"), (["5"], "differs from the review")):
        refused = await client.post(f"{path}/start", data={"row": rows})
        assert (refused.status_code, words in refused.text) == (422, True)
    assert (await client.post(f"{path}/start", data={"row": ["6", "20"]})).status_code == 303
    end = await ended(house, client, path.rpartition("/")[2])
    assert end["state"] == "equal"
    assert {number for _, number, _ in line.written} == {6, 20}
    assert {row["number"]: row["reason_code"] for row in end["left_out"] if row["differs"]} == {
        7: "deselected",
        27: "dangerous",
        37: "operating_value",
    }


async def test_a_second_look_keeps_what_was_deselected_and_no_setpoint(
    house: House, client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    planned = await plan(client, golden, include=[20], exclude=[6])
    line.memory[2][7] = 62
    await client.post(f"/api/v1/restores/{planned['id']}/start")
    await ended(house, client, planned["id"])
    again = await client.post(f"/restores/{planned['id']}/again")
    fresh = (await client.get(f"/api/v1{again.headers['location']}")).json()
    assert selected(fresh) == {6: False, 7: True, 20: False, 37: False}


async def test_confirming_a_danger_plans_again_with_it(
    client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    planned = await plan(client, golden)
    ticked = await client.post(f"/restores/{planned['id']}/tick", data={"tick": ["27"]})
    fresh = (await client.get(f"/api/v1{ticked.headers['location']}")).json()
    assert selected(fresh) == {6: True, 7: True, 27: True, 20: False, 37: False}
    assert line.written == []
    assert fresh["id"] != planned["id"]


@pytest.mark.usefixtures("line")
async def test_a_list_of_sets_links_to_its_next_page(client: httpx.AsyncClient) -> None:
    for _ in range(3):
        saved = await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [1]})
        assert saved.status_code == 201, saved.text
    pages, path = [], f"/api/v1/sets?bus={BUS}&limit=2"
    while path:
        response = await client.get(path)
        pages.append([each["id"] for each in response.json()])
        path = response.links["next"]["url"] if response.links else ""
    assert [len(page) for page in pages] == [2, 1]
    found = [number for page in pages for number in page]
    assert found == sorted(set(found), reverse=True)
