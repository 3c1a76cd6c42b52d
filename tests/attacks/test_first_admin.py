"""Becoming the first admin of a site without the code that its server printed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.people.auth.accounts import Accounts
from app.people.auth.sign_in import FREE, OF_NAME, FirstAdmin, new_code
from tests.app.complete_app import PASSWORD, House, complete_app
from tests.for_each import for_each


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


@pytest.fixture
def within_a_moment(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(house.services[FirstAdmin], "_monotonic", lambda: 1_000.0)


def code_of(house: House) -> str:
    return house.services[FirstAdmin].code


async def create(client: httpx.AsyncClient, code: str, name: str = "ada") -> int:
    form = {"code": code, "name": name, "password": PASSWORD, "again": PASSWORD}
    return (await client.post("/setup", data=form)).status_code


async def users(house: House) -> list[tuple[str, str]]:
    return [(user.name, user.role.value) for user in await house.services[Accounts].users()]


async def test_the_code_makes_one_signed_in_and_recorded_admin(house: House) -> None:
    client, code = house.client(), code_of(house)
    assert await create(client, code.lower().replace("-", " ")) == 303
    assert (await client.get("/api/v1/me")).json()["role"] == "admin"
    (added,) = await house.events("user")
    assert (added["who"], added["origin"]) == ("ada", house.address)
    assert code not in str(added)
    assert code_of(house) == "", "it is spent"
    assert await create(house.client(), code, "eve") == 409
    assert (await house.client().get("/setup")).headers["location"] == "/login"
    assert await users(house) == [("ada", "admin")]


@pytest.mark.usefixtures("within_a_moment")
async def test_guessing_the_code_is_bounded_and_recorded(house: House) -> None:
    client = house.client()
    statuses = [await create(client, new_code()) for _ in range(20)]
    assert (statuses.count(401), statuses.count(429)) == (FREE, 20 - FREE)
    assert await create(client, code_of(house)) == 429, "nor is the right one tried before the time"
    assert await users(house) == []
    (refused,) = await house.events("login_refused")
    assert refused["who"] == "unknown name", "a typed name may be a secret"


@pytest.mark.usefixtures("within_a_moment")
async def test_guessing_from_many_networks_is_bounded_too(house: House) -> None:
    statuses = []
    for number in range(2 * OF_NAME):
        house.address = f"198.51.100.{number}"
        statuses.append(await create(house.client(), new_code()))
    assert statuses.count(401) <= OF_NAME


@for_each("code", ["", "\u212a" * 12, "A" * 5000])
async def test_a_malformed_code_is_a_wrong_one(house: House, code: str) -> None:
    assert await create(house.client(), code) == 401
    assert await users(house) == []


async def test_of_two_at_once_one_is_the_first(house: House) -> None:
    code = code_of(house)
    statuses = await asyncio.gather(*(create(house.client(), code, name) for name in ("ada", "eve")))
    assert sorted(statuses) == [303, 409]
    assert len(await users(house)) == 1


async def test_a_foreign_page_cannot_use_it(house: House) -> None:
    assert await create(house.client(origin="http://evil.example"), code_of(house)) == 403


async def test_a_demo_has_no_code(tmp_path: Path) -> None:
    async with complete_app(tmp_path, demo=True) as house:
        assert code_of(house) == ""
        assert await create(house.client(), "") == 409


async def test_a_start_with_a_user_has_no_code(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        await house.add("ann", Role.VIEWER)
    async with complete_app(tmp_path) as house:
        assert code_of(house) == ""
