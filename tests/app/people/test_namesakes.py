"""A user and a token of the same name: control, keys and events distinguish them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.people.auth.accounts import Accounts
from tests.administrator import BY
from tests.app.complete_app import House, complete_app

BUS = "/api/v1/buses/dry-end"
SPEED = f"{BUS}/units/1/speed"
NAME = "key-operator"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, control=True) as house:
        yield house


@pytest.fixture
async def user(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.OPERATOR, NAME)


@pytest.fixture
async def token(house: House) -> httpx.AsyncClient:
    return await house.program(Role.OPERATOR)


async def test_control_of_one_is_not_that_of_the_other(
    house: House, user: httpx.AsyncClient, token: httpx.AsyncClient
) -> None:
    lease = (await user.post(f"{BUS}/control")).json()
    assert (lease["holder"], lease["is_token"]) == (NAME, False)
    response = await token.post(SPEED, json={"raw": 5})
    assert (response.status_code, response.json()["code"]) == (409, "controlled")
    assert (await token.post(f"{BUS}/control")).status_code == 409
    assert (await token.request("DELETE", f"{BUS}/control")).status_code == 409
    assert (await user.post(SPEED, json={"raw": 5})).json()["code"] == "bus_closed", "it came past control"
    handed = (await user.post(f"{BUS}/control/hand-over", json={"to": f"{NAME} (token)"})).json()
    assert (handed["holder"], handed["is_token"]) == (NAME, True)
    assert (await user.post(SPEED, json={"raw": 5})).json()["code"] == "controlled"
    page = await user.get("/control?bus=dry-end")
    assert f"Control: {NAME} (token)" in page.text
    assert [(event["old"], event["new"]) for event in await house.events("control")] == [
        (NAME, f"{NAME} (token)"),
        (None, NAME),
    ]


async def test_what_the_one_holds_stays_when_the_other_goes(house: House, user: httpx.AsyncClient) -> None:
    await house.token(Role.OPERATOR)
    await user.post(f"{BUS}/control")
    await house.services[Accounts].revoke_token(NAME, **BY)
    assert (await user.get(f"{BUS}/control")).json()["holder"] == NAME


async def test_a_key_of_one_is_not_that_of_the_other(
    user: httpx.AsyncClient, token: httpx.AsyncClient
) -> None:
    key = {"Idempotency-Key": "press-1"}
    await user.post(f"{BUS}/control")
    assert (await user.post(SPEED, json={"raw": 5}, headers=key)).json()["code"] == "bus_closed"
    response = await token.post(SPEED, json={"raw": 5}, headers=key)
    assert response.json()["code"] == "controlled", "a separate command, and refused as such"


async def test_the_events_name_which_of_them_it_was(
    house: House, user: httpx.AsyncClient, token: httpx.AsyncClient
) -> None:
    for client in (user, token):
        await client.post(f"{BUS}/control")
        await client.post(SPEED, json={"raw": 5})
        await client.request("DELETE", f"{BUS}/control")
    for kind, origins in (
        ("command", ["api, token", "api"]),
        ("control", [*["token"] * 2, *["session"] * 2]),
    ):
        events = await house.events(kind)
        assert [event["origin"] for event in events] == origins
        assert {event["who"] for event in events} == {NAME}
