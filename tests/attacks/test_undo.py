"""Undo that is replayed, forged, of another person, or of what has changed since its review."""

from __future__ import annotations

import re
from html import unescape
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.line.commands import undo as stack
from app.line.commands.service import CommandService
from app.people.auth.accounts import Accounts
from bus.instants import unix_now
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, House
from tests.app.played_line import BUS, PlayedLine
from tests.for_each import for_each

NUMBER, BEFORE, SET = 12, 20, 30
PARAMETER = f"/units/{BUS}/1/parameters/{NUMBER}"
OVER = "cannot be undone now"


@pytest.fixture
async def client(house: House, line: PlayedLine) -> httpx.AsyncClient:
    """Has written the parameter under the id ``first``."""
    line.memory[1][NUMBER] = BEFORE
    client = await house.signed_in(Role.ENGINEER)
    program = await house.program(Role.ENGINEER)
    await program.post(f"/api/v1/buses/{BUS}/units/1/parameters/read", json={"numbers": [NUMBER]})
    await client.post(f"/units/{BUS}/1/parameters/read")
    assert (await write(client, SET, "first")).status_code == 200
    assert line.memory[1][NUMBER] == SET
    return client


async def write(client: httpx.AsyncClient, raw: int, id: str, undoes: str = "") -> httpx.Response:
    form: dict[str, Any] = {"raw": raw, "id": id, "reviewed_at": unix_now(), "undoes": undoes}
    form["scale"] = "-"
    return await client.post(PARAMETER, data={**form, "typed": "WRITE"})


async def review(client: httpx.AsyncClient, id: str = "first") -> dict[str, str]:
    """The form of the review of an undo."""
    page = await client.get(f"/bus/{BUS}/undo/{id}")
    assert page.status_code == 200, page.text
    fields = re.findall(r'<input type="hidden" name="(\w+)" value="([^"]*)"', page.text)
    return {name: unescape(value) for name, value in fields} | {"typed": "WRITE"}


async def test_an_undo_twice_is_one(client: httpx.AsyncClient, line: PlayedLine) -> None:
    form = await review(client)
    done = [await client.post(PARAMETER, data=form) for _ in range(2)]
    assert [each.status_code for each in done] == [200, 200]
    assert line.written == [(1, NUMBER, SET), (1, NUMBER, BEFORE)]
    again = await client.post(PARAMETER, data={**form, "id": "another-id"})
    assert (again.status_code, OVER in again.text) == (409, True)
    assert len(line.written) == 2


async def test_of_another_person_and_of_a_later_account_of_the_name(
    house: House, client: httpx.AsyncClient, line: PlayedLine
) -> None:
    assert (await client.get(f"/bus/{BUS}/undo/first")).status_code == 200
    other = await house.signed_in(Role.ENGINEER, "other")
    assert (await other.get(f"/bus/{BUS}/undo/first")).status_code == 409
    assert (await write(other, BEFORE, "x" * 8, undoes="first")).status_code == 409
    await house.services[Accounts].remove_user("other", **BY)
    await house.services[Accounts].remove_user("the-engineer", **BY)
    later = await house.signed_in(Role.ENGINEER)
    assert (await later.get(f"/bus/{BUS}/undo/first")).status_code == 409
    assert (await write(later, BEFORE, "y" * 8, undoes="first")).status_code == 409
    assert line.memory[1][NUMBER] == SET


async def test_another_session_of_the_person_may(
    house: House, client: httpx.AsyncClient, line: PlayedLine
) -> None:
    other = house.client()
    await other.post("/login", data={"name": "the-engineer", "password": PASSWORD})
    form = await review(other)
    await client.post("/logout")
    gone = await client.post(PARAMETER, data=form)
    assert (gone.status_code, gone.headers["location"].partition("?")[0]) == (303, "/login")
    assert (await other.post(PARAMETER, data=form)).status_code == 200
    assert line.memory[1][NUMBER] == BEFORE


@for_each("changed", [{"raw": "25"}, {"undoes": "none"}, {"reviewed_at": "0"}, {"reviewed_at": "nan"}])
async def test_a_changed_form_sends_nothing(
    client: httpx.AsyncClient, line: PlayedLine, changed: dict[str, str]
) -> None:
    refused = await client.post(PARAMETER, data={**await review(client), **changed})
    assert refused.status_code == 409
    assert line.memory[1][NUMBER] == SET


@for_each("path", [f"/units/{BUS}/2/parameters/{NUMBER}", f"/units/{BUS}/1/parameters/11"])
async def test_a_form_for_another_value_sends_nothing(
    client: httpx.AsyncClient, line: PlayedLine, path: str
) -> None:
    refused = await client.post(path, data=await review(client))
    assert (refused.status_code, OVER in refused.text) == (409, True)
    assert len(line.written) == 1


async def test_what_another_person_has_set_since_its_review_stays(
    house: House, client: httpx.AsyncClient, line: PlayedLine
) -> None:
    form = await review(client)
    other = await house.signed_in(Role.ENGINEER, "other")
    assert (await write(other, 25, "z" * 8)).status_code == 200
    refused = await client.post(PARAMETER, data=form)
    assert (refused.status_code, OVER in refused.text) == (409, True)
    assert line.memory[1][NUMBER] == 25


async def test_after_a_minute_only_a_review_that_began_in_time(
    house: House, client: httpx.AsyncClient, line: PlayedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    undoing, form = house.services.buses[BUS][CommandService].undo, await review(client)
    clock, ahead = undoing._clock, 60.0
    monkeypatch.setattr(undoing, "_clock", lambda: clock() + ahead)
    assert (await client.get(f"/bus/{BUS}/undo/first")).status_code == 409
    ahead = 60.0 + stack.REVIEW_LASTS_S
    assert (await client.post(PARAMETER, data={**form, "reviewed_at": str(unix_now())})).status_code == 409
    ahead = 60.0
    assert (await client.post(PARAMETER, data={**form, "id": "in-time-1"})).status_code == 200
    assert line.memory[1][NUMBER] == BEFORE
