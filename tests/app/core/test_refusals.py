"""Refusals are recorded, and requests cannot flood the record."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from starlette.types import Message, Scope
from starlette.websockets import WebSocketDisconnect
from structlog.testing import capture_logs

from app.core.database import Database
from app.core.web.access import Role
from app.people.audit.log import EventLog
from app.people.auth import identify as access
from app.people.auth.accounts import Accounts
from tests.administrator import BY
from tests.app.complete_app import House, complete_app

SPEED = "/api/v1/buses/dry-end/units/1/speed"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


async def recorded(house: House) -> list[tuple[str, str, str, str, int]]:
    await house.services[EventLog].repeated.record_due(everything=True)
    events = await house.events("access_refused")
    names = ("what", "who", "origin", "message")
    return [(*(event[name] for name in names), event["count"] or 1) for event in reversed(events)]


async def test_a_request_beyond_the_role_is_recorded(house: House) -> None:
    client = await house.signed_in(Role.VIEWER, "vera")
    for _ in range(50):
        assert (await client.post(SPEED, json={"raw": 1})).status_code == 403
    route = "POST /api/v1/buses/{bus}/units/{unit}/speed"
    assert await recorded(house) == [
        ("access refused", "vera", "192.0.2.7", route, 1),
        ("access refused", "vera", "192.0.2.7", route, 49),
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
    accounts = house.services[Accounts]
    token = await accounts.create_token("report", Role.VIEWER, expires_days=1, **BY)
    await house.services[Database].write(lambda c: c.execute("UPDATE tokens SET expires_at = 1.0"))
    response = await house.client(Authorization=f"Bearer {token}").get("/api/v1/line")
    assert (response.status_code, "expired on 1970-01-01" in response.json()["detail"]) == (401, True)
    assert await recorded(house) == [("token refused", "report (token)", "192.0.2.7", "", 1)]


async def test_many_addresses_are_recorded_as_many(house: House) -> None:
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


async def test_a_request_without_sign_in_is_not_recorded(house: House) -> None:
    assert (await house.client().get("/api/v1/line")).status_code == 401
    assert (await house.client(cookie="lineside_session=old").get("/api/v1/line")).status_code == 401
    assert await recorded(house) == []


async def test_responses_that_refuse_are_logged_by_address(house: House) -> None:
    requests = [
        (None, "GET", "/healthz", 200),
        (Role.VIEWER, "GET", "/nowhere", 404),
        (None, "GET", "/api/v1/line", 401),
        (None, "POST", "/login", 413),
        (Role.VIEWER, "POST", SPEED, 403),
    ]
    with capture_logs() as logs:
        for number, (role, method, path, status) in enumerate(requests):
            house.address = f"192.0.2.{number}"
            client = house.client() if role is None else await house.signed_in(role, f"vera{number}")
            content = b"x" * 100_000 if status == 413 else b""
            assert (await client.request(method, path, content=content)).status_code == status
    refused = [entry for entry in logs if entry["event"] == "request refused"]
    assert [(entry["address"], entry["reason"], entry["request"]) for entry in refused] == [
        ("192.0.2.3", "413", "/login"),
        ("192.0.2.4", "403", SPEED),
    ]


async def test_a_client_that_leaves_its_handshake_is_a_refused_request(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def leave(*_: object) -> None:
        raise WebSocketDisconnect(1006)

    async def receive() -> Message:
        return {"type": "websocket.disconnect"}

    async def send(_: Message) -> None: ...

    monkeypatch.setattr(access, "refuse", leave)
    scope: Scope = {"type": "websocket", "path": "/feed", "headers": [], "client": ("192.0.2.7", 1)}
    with capture_logs() as logs:
        await house.app(scope | {"query_string": b"", "scheme": "ws"}, receive, send)
    assert [(entry["address"], entry["reason"]) for entry in logs] == [("192.0.2.7", "incomplete")]
