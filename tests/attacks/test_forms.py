"""Forms of a unit that is of another bus or of none, numbers that are none, forms after a session."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.engineering.tray.contents import Trays
from app.people.auth.accounts import Accounts
from bus.contract import Reading
from bus.instants import unix_now
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, House, complete_app
from tests.app.fake_worker import until
from tests.app.played_commands import HEALTHY, REMOTE
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.attacks.withdrawals import withdraw

CONFIGURATION = f"""
[server]
data = "data"
[[bus]]
name = "{BUS}"
port = "/dev/null"
unit = [{{ id = 1, name = "Unwind" }}, {{ id = 2, name = "Nip" }}]
[[bus]]
name = "wet-end"
port = "/dev/zero"
unit = [{{ id = 7, name = "Pump" }}]
"""
ELSEWHERE = [f"{BUS}/7", "wet-end/1", f"{BUS}/0", f"{BUS}/256", f"{BUS}/{'9' * 300}", "no-bus/1", "/1"]
TEXTS = ["", "NaN", "inf", "-1", "1e3", "0x10", "1.2.3", "5\0", "9" * 5000, "\u00b2", "1\u202e2", "[]"]
OF_OTHER_SCRIPTS = ["\u0663", "\uff15"]
OF_UNIT: dict[str, Mapping[str, str]] = {
    "tray/setpoint": {"value": "#"},
    "tray/outputs/1": {"on": "#"},
    "tray/outputs/9": {"on": "true"},
    "tray/analog-output": {"value": "#"},
    "tray/parameters/6": {"raw": "#"},
    "tray/parameters/41": {"raw": "5"},
    "review": {"value": "#"},
    "speed": {"raw": "#", "was": "0", "how": "now"},
    "nudge": {"step": "#"},
    "execute": {"raw": "#"},
    "outputs/1": {"on": "#"},
    "analog-output/review": {"value": "#"},
    "analog-output": {"raw": "#"},
    "parameters/6/review": {"value": "#"},
    "parameters/6": {"raw": "#", "typed": "WRITE"},
    "limits": {"lowest": "#", "highest": "#", "largest_step": "#"},
}
OF_BUS: dict[str, tuple[str, Mapping[str, str]]] = {
    "group change": ("/setpoints", {"bus": BUS, "raw-1": "#", "was-1": "0"}),
    "group change of others": ("/setpoints", {"bus": BUS, "raw-7": "5", "was-7": "", "leave-out": "#"}),
    "group change of no bus": ("/setpoints", {"bus": "#", "raw-1": "5", "was-1": "0"}),
    "its review": ("/setpoints/review", {"bus": BUS, "new-1": "#", "new-7": "#"}),
    "tray of a bus": (f"/bus/{BUS}/tray/setpoints", {"new-1": "#", "new-7": "5"}),
    "sent tray": (f"/bus/{BUS}/tray/send", {"row": "#"}),
    "forged row": (f"/bus/{BUS}/tray/send", {"row": "setpoint-7-0:5:"}),
    "row of no unit": (f"/bus/{BUS}/tray/send", {"row": "parameter-999-99:999999:0"}),
    "left out of a tray": (f"/bus/{BUS}/tray/send", {"row": "setpoint-1-0:5:0", "leave-out": "#"}),
    "removed from a tray": (f"/bus/{BUS}/tray/remove", {"place": "#"}),
    "zero": (f"/bus/{BUS}/zero", {"raw-1": "#", "was-1": "#"}),
    "recipe": ("/recipes/save", {"bus": BUS, "name": "Fine", "unit-1": "#", "unit-7": "5"}),
    "recipe of no bus": ("/recipes/save", {"bus": "#", "name": "Fine", "unit-1": "5"}),
    "loaded recipe": ("/recipes/1/load", {"raw-1": "#", "leave-out": "#"}),
    "batch": (f"/batch/{BUS}/review", {"number": "6", "unit-1": "#", "unit-7": "5"}),
    "number of a batch": (f"/batch/{BUS}/write", {"number": "#", "unit-1": "5", "was-1": "0"}),
    "tray of a batch": (f"/batch/{BUS}/tray", {"number": "#", "unit-1": "5"}),
    "set": ("/sets/take", {"bus": BUS, "unit": "#"}),
    "set of no bus": ("/sets/take", {"bus": "#", "unit": "1"}),
    "schedule": ("/sets/schedule", {"bus": "#", "at": "#"}),
    "restore": (f"/units/{BUS}/1/restore", {"source": "#"}),
    "restore of a set of none": (f"/units/{BUS}/7/restore", {"source": "set:1:7"}),
    "started restore": ("/restores/none/start", {"row": "#"}),
    "swap": (f"/swap/{BUS}/1", {"source": "#"}),
    "swap of none": (f"/swap/{BUS}/7", {"source": "sheet"}),
    "baud": (f"/bus/{BUS}/baud", {"baud": "#"}),
    "control": (f"/bus/{BUS}/control", {"do": "hand-over", "to": "#"}),
}
REFUSALS = (404, 405, 409, 422)


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    config = tmp_path / "lineside.toml"
    config.write_text(CONFIGURATION)
    async with complete_app(tmp_path, config=config) as house:
        yield house


@pytest.fixture
async def line(house: House) -> PlayedLine:
    return await played_line(house.services)


async def send(client: httpx.AsyncClient, path: str, form: Mapping[str, Any], text: str) -> httpx.Response:
    filled = {key: text if value == "#" else value for key, value in form.items()}
    review = {"id": "an-id-of-a-form", "reviewed_at": str(unix_now()), "scale": "-"}
    return await client.post(path, data={**review, **filled}, headers={"hx-request": "true"})


def written(line: PlayedLine) -> list[object]:
    return [*line.written, *(command for command in line.held if command.action.writes)]


def some(texts: list[str], number: int) -> list[str]:
    """Every third, beginning elsewhere for each form."""
    return texts[number % 3 :: 3]


async def test_a_form_of_a_unit_of_another_bus_or_of_none(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ADMIN)
    for number, (path, form) in enumerate(OF_UNIT.items()):
        for unit in some(ELSEWHERE, number):
            response = await send(client, f"/units/{unit}/{path}", form, "5")
            assert response.status_code in REFUSALS, (path, unit, response.text)
    assert written(line) == []
    assert [trays._trays for trays in house.services.of_buses(Trays).values()] == [{}, {}]


async def test_a_number_of_a_unit_that_is_none(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ADMIN)
    for number, (path, form) in enumerate(OF_UNIT.items()):
        for text in some(TEXTS, number):
            response = await send(client, f"/units/{BUS}/1/{path}", form, text)
            assert response.status_code < 500, (path, text[:20], response.text)
    assert written(line) == []


async def test_a_form_of_a_bus_with_a_number_that_is_none(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ADMIN)
    texts = [*TEXTS, *OF_OTHER_SCRIPTS, "wet-end", "set:1:7", "setpoint-7-0"]
    for number, (name, (path, form)) in enumerate(OF_BUS.items()):
        for text in texts if name == "group change" else some(texts, number):
            response = await send(client, path, form, text)
            assert response.status_code < 500, (name, text[:20], response.text)
    assert written(line) == []


FORM = {"number": "6", "raw": "5", "typed": "WRITE"}


async def test_a_form_that_is_pressed_twice_is_one_command(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)
    path = f"/units/{BUS}/1/parameters/6"
    done = await asyncio.gather(*(send(client, path, FORM, "") for _ in range(4)))
    assert {each.status_code for each in done} == {200}
    assert line.written == [(1, 6, 5)]
    other = await send(client, path, {**FORM, "raw": "6"}, "")
    assert other.status_code in (409, 422)
    assert line.written == [(1, 6, 5)]


@pytest.mark.parametrize("how", ["signed out", "demoted", "made again"])
async def test_a_form_of_a_session_that_is_over_sends_nothing(
    house: House, line: PlayedLine, how: str
) -> None:
    client = await house.signed_in(Role.ENGINEER)
    path = f"/units/{BUS}/1/parameters/6"
    tray = {"raw": "5"}
    assert (await send(client, f"/units/{BUS}/1/tray/parameters/6", tray, "")).status_code == 200
    await withdraw(house, how, client=client)
    cookies = dict(client.cookies)
    replayed = house.client()
    replayed.cookies.update(cookies)
    row = {"row": "parameter-6-0:5:0"}
    for browser in (client, replayed):
        for form, fields in ((path, FORM), (f"/bus/{BUS}/tray/send", row)):
            refused = await send(browser, form, fields, "")
            assert refused.status_code != 200 or refused.headers.get("hx-redirect"), refused.text
    assert written(line) == []


async def test_a_tray_of_an_engineer_is_not_sent_by_an_operator(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)
    await send(client, f"/units/{BUS}/1/tray/parameters/6", {"raw": "5"}, "")
    await house.services[Accounts].set_role("the-engineer", Role.OPERATOR, **BY)
    again = house.client()
    await again.post("/login", data={"name": "the-engineer", "password": PASSWORD})
    review = (await again.get(f"/bus/{BUS}/tray/review", headers={"hx-request": "true"})).text
    rows = re.findall(r'name="row" value="([^"]+)"', review)
    for row in rows or ["parameter-1-6:5:0", "parameter-1-6:5:"]:
        refused = await send(again, f"/bus/{BUS}/tray/send", {"row": row, "typed": "WRITE"}, "")
        assert refused.status_code >= 400, refused.text
    assert written(line) == []


async def carried_out(line: PlayedLine, sending: asyncio.Future[httpx.Response], raw: int) -> httpx.Response:
    """The response, once unit 1 has taken the setpoint and reads it."""
    await until(lambda: line.held, "the command")
    line.live.buses[BUS].apply([Reading(1, time.time(), raw, 0, 0, REMOTE, HEALTHY)])
    line.end("verified")
    return await sending


RESENT = {
    "setpoint": (f"/units/{BUS}/1/speed", {"raw": "5", "was": "0", "how": "now"}),
    "group change": ("/setpoints", {"bus": BUS, "raw-1": "5", "was-1": "0", "scale-1": "-"}),
}


@pytest.mark.parametrize("form", RESENT)
async def test_a_form_that_is_sent_again_shows_its_result(house: House, line: PlayedLine, form: str) -> None:
    """The response was lost on the way: to state that nothing was sent would be wrong."""
    client = await house.signed_in(Role.ENGINEER)
    path, fields = RESENT[form]
    done = await carried_out(line, asyncio.ensure_future(send(client, path, fields, "")), 5)
    again = await send(client, path, {**fields, "reviewed_at": "0"}, "")
    assert (done.status_code, again.status_code) == (200, 200)
    assert "nothing was sent" not in again.text
    assert len(line.held) == 1
    other = await send(client, path, {**fields, "id": "another-id-of-a-form"}, "")
    assert (other.status_code, "nothing was sent" in other.text) == (409, True)
