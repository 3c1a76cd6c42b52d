"""What was refused is on record, and nobody can flood the record."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.web.access import Role
from tests.app.whole_app import House, whole_app

SPEED = "/api/v1/buses/dry-end/units/1/speed"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with whole_app(tmp_path) as house:
        yield house


async def recorded(house: House) -> list[tuple[str, str, str, str, int]]:
    await house.services.events.repeated.tell_rest()
    events = await house.events("access_refused")
    names = ("what", "who", "origin", "message")
    return [(*(event[name] for name in names), event["count"] or 1) for event in reversed(events)]


async def test_who_asks_for_more_than_a_role_gives_is_on_record(house: House) -> None:
    client = await house.signed_in(Role.VIEWER, "vera")
    for _ in range(50):
        assert (await client.post(SPEED, json={"raw": 1})).status_code == 403
    asked = "POST /api/v1/buses/{bus}/units/{unit}/speed"
    assert await recorded(house) == [
        ("access refused", "vera", "192.0.2.7", asked, 1),
        ("access refused", "vera", "192.0.2.7", asked, 49),
    ]


async def test_tokens_that_are_not_good_are_one_event_a_minute(house: House) -> None:
    for number in range(50):
        client = house.client(Authorization=f"Bearer guess-{number}")
        assert (await client.get("/api/v1/line")).status_code == 401
    assert await recorded(house) == [
        ("token refused", "unknown token", "192.0.2.7", "", 1),
        ("token refused", "unknown token", "192.0.2.7", "", 49),
    ]


async def test_a_token_that_has_expired_is_named(house: House) -> None:
    accounts = house.services.accounts
    token = await accounts.create_token("report", Role.VIEWER, expires_days=1, by="ann", origin="test")
    await house.services.database.write(lambda c: c.execute("UPDATE tokens SET expires_at = 1.0"))
    answer = await house.client(Authorization=f"Bearer {token}").get("/api/v1/line")
    assert (answer.status_code, "expired on 1970-01-01" in answer.json()["detail"]) == (401, True)
    assert await recorded(house) == [("token refused", "report (token)", "192.0.2.7", "", 1)]


async def test_many_addresses_are_told_as_many(house: House) -> None:
    for number in range(100):
        house.address = f"198.51.100.{number}"
        await house.client(Authorization="Bearer guess").get("/api/v1/line")
    events = await recorded(house)
    assert len(events) < 30
    assert events[-1] == ("token refused", "unknown token", "several addresses", "", 79)


async def test_a_subnet_of_ipv6_is_one_sender(house: House) -> None:
    for number in range(50):
        house.address = f"2001:db8::{number:x}"
        await house.client(Authorization="Bearer guess").get("/api/v1/line")
    assert {origin for _, _, origin, *_ in await recorded(house)} == {"2001:db8::/64"}


async def test_a_foreign_page_is_on_record(house: House) -> None:
    await house.client(origin="http://evil.example").post("/login", data={"name": "ann"})
    assert await recorded(house) == [("request from a page of another site refused", "", "192.0.2.7", "", 1)]


async def test_who_is_not_signed_in_is_not(house: House) -> None:
    assert (await house.client().get("/api/v1/line")).status_code == 401
    assert (await house.client(cookie="lineside_session=old").get("/api/v1/line")).status_code == 401
    assert await recorded(house) == []
