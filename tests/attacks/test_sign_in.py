"""Guessing, locking others out, and going on after one's rights have ended."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.types import Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from app.core.web.access import Role
from app.main import create_app
from app.people.audit.log import EventLog
from app.people.auth import passwords
from app.people.auth.accounts import Accounts
from app.people.auth.identify import NO_LONGER_SIGNED_IN
from app.people.auth.pages import DEVICE_COOKIE
from app.people.auth.rights import Rights
from app.people.auth.rules import SECRET_LENGTH
from app.people.auth.sign_in import FREE, OF_ADDRESS, OF_NAME, SignIn
from bus.contract import CONTRACT_VERSION, Hello, encode
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, House, complete_app, settings_in
from tests.sizes import sizes


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


@pytest.fixture
def within_a_moment(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the machine takes for it: after 2 s one more may be tried."""
    monkeypatch.setattr(house.services[SignIn], "_monotonic", lambda: 1_000.0)


def at(house: House, address: str) -> httpx.AsyncClient:
    """A browser at this address."""
    house.address = address
    return house.client()


async def sign_in(client: httpx.AsyncClient, name: str = "ann", password: str = PASSWORD) -> int:
    return (await client.post("/login", data={"name": name, "password": password})).status_code


async def test_a_named_operator_cannot_be_locked_out(house: House) -> None:
    await house.add("ann", Role.OPERATOR)
    own = at(house, "192.0.2.7")
    assert await sign_in(own) == 303
    for number in range(40):
        assert await sign_in(at(house, f"198.51.100.{number}"), password="wrong") in (401, 429)
    assert (await own.get("/api/v1/me")).status_code == 200, "a user a user who is signed in stays so"
    await own.post("/logout")
    assert await sign_in(own) == 303, "and may come back at once"
    assert await sign_in(at(house, "192.0.2.7")) == 303, "with another browser too"


@pytest.mark.usefixtures("within_a_moment")
async def test_guessing_from_one_place_comes_to_nothing(house: House) -> None:
    await house.add("ann", Role.OPERATOR)
    client = at(house, "198.51.100.1")
    statuses = [await sign_in(client, password=f"guess{number}") for number in range(20)]
    assert statuses.count(401) == FREE
    assert statuses.count(429) == 20 - FREE


async def many_names_from_here(house: House, _: str, address: str) -> None:
    for number in range(OF_ADDRESS):
        await sign_in(at(house, address), f"other{number}", "wrong")


async def this_name_from_elsewhere(house: House, name: str, _: str) -> None:
    for number in range(OF_NAME + FREE):
        await sign_in(at(house, f"198.51.100.{number}"), name, "wrong")


async def many_at_once_from_here(house: House, _: str, address: str) -> None:
    client = at(house, address)
    await asyncio.gather(*(sign_in(client, f"other{number}", "wrong") for number in range(20)))


async def its_owner_signs_in_here(house: House, name: str, address: str) -> None:
    """In a new browser; with a name that no user has, no one does."""
    client = at(house, address)
    for _ in range(FREE - 1):
        await sign_in(client, name, "wrong")
    if name == "ann":
        assert await sign_in(at(house, address)) == 303


@pytest.mark.usefixtures("within_a_moment")
@pytest.mark.parametrize(
    "before",
    sizes(this_name_from_elsewhere, many_names_from_here, many_at_once_from_here, its_owner_signs_in_here),
)
@pytest.mark.parametrize("browser", ["another", "of a colleague"])
async def test_at_a_shared_address_a_refusal_does_not_reveal_which_names_exist(
    house: House, before: Callable[[House, str, str], Awaitable[None]], browser: str
) -> None:
    """A user who had signed in there got 401 where other names got 429."""
    await house.add("ann", Role.OPERATOR)
    await house.add("bob", Role.OPERATOR)
    statuses, tried = {}, {"ann": "192.0.2.7", "no-one": "192.0.2.8"}
    guessing = {address: at(house, address) for address in tried.values()}
    for address, client in guessing.items():
        assert await sign_in(at(house, address), "ann") == 303
        assert await sign_in(client if browser == "of a colleague" else at(house, address), "bob") == 303
        await client.post("/logout")
    for name, address in tried.items():
        await before(house, name, address)
        statuses[name] = [
            await sign_in(guessing[address], name, f"guess{number}") for number in range(2 * FREE)
        ]
    assert statuses["ann"] == statuses["no-one"]
    assert 429 in statuses["ann"]


async def test_the_cookie_that_knows_a_browser_signs_no_one_in_and_is_kept_as_its_hash(
    house: House, tmp_path: Path
) -> None:
    await house.add("ann", Role.OPERATOR)
    client = at(house, "192.0.2.7")
    response = await client.post("/login", data={"name": "ann", "password": PASSWORD})
    (cookie,) = [
        each for each in response.headers.get_list("set-cookie") if each.startswith(f"{DEVICE_COOKIE}=")
    ]
    assert {"HttpOnly", "SameSite=lax"} <= set(cookie.split("; "))
    device = client.cookies[DEVICE_COOKIE]
    assert len(device) == SECRET_LENGTH
    stranger = at(house, "198.51.100.1")
    stranger.cookies.set(DEVICE_COOKIE, device)
    assert (await stranger.get("/api/v1/me")).status_code == 401
    stored = b"".join(path.read_bytes() for path in (tmp_path / "data").rglob("*") if path.is_file())
    assert device.encode() not in stored


async def test_many_sign_ins_at_once_delay_only_their_own_place(house: House) -> None:
    """All waited for one lock, 20 ms each."""
    await house.add("ann", Role.OPERATOR)
    assert await sign_in(at(house, "192.0.2.7")) == 303
    attacker = at(house, "198.51.100.1")
    flood = [asyncio.create_task(sign_in(attacker, f"n{number}", "x")) for number in range(80)]
    await asyncio.sleep(0)
    assert await sign_in(at(house, "192.0.2.7")) == 303
    statuses = await asyncio.gather(*flood)
    assert set(statuses) <= {401, 429}
    assert statuses.count(429) > 40


async def test_the_time_of_a_refusal_does_not_reveal_which_names_exist(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An unknown name was checked with today's parameters of Argon2, a user of an earlier version with that
    one's; and the first refusal of a known name was on disk before the response.
    """
    verified: list[str] = []
    monkeypatch.setattr(passwords, "_hasher", _Hasher(verified))
    for number in range(4):
        await house.add(f"user{number}", Role.VIEWER)
    names = [f"nobody{number}" for number in range(20)]
    for name in names * 2:
        assert await sign_in(at(house, f"198.51.100.{len(verified)}"), name) == 401
    first, again = verified[:20], verified[20:]
    assert first == again, "a name takes as long each time"
    assert set(first) <= {f"hash {number} of {PASSWORD}" for number in range(1, 5)}
    assert len(set(first)) > 1, "as users do, so do unknown names"


class _Hasher:
    """Takes every secret for the right one, and notes which hash it is compared with."""

    def __init__(self, verified: list[str]) -> None:
        self._verified = verified
        self._count = 0

    def hash(self, secret: str) -> str:
        self._count += 1
        return f"hash {self._count} of {secret}"

    def verify(self, stored: str, _: str) -> bool:
        self._verified.append(stored)
        return True

    def check_needs_rehash(self, _: str) -> bool:
        return False


async def test_a_refusal_is_returned_before_it_is_recorded(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is waited for by known names only: unknown ones are counted together."""
    await house.add("ann", Role.OPERATOR)
    order: list[str] = []
    record = house.services[EventLog].record

    async def recording(**fields: Any) -> int:
        order.append(fields["what"].code)
        return await record(**fields)

    monkeypatch.setattr(house.services[EventLog].repeated, "_record", recording)

    async def watched(scope: Scope, receive: Receive, send: Send) -> None:
        async def sending(message: Message) -> None:
            if message["type"] == "http.response.body":
                order.append("answered")
            await send(message)

        await house.app(scope, receive, sending)

    transport = httpx.ASGITransport(watched, client=("192.0.2.7", 4711))
    async with httpx.AsyncClient(transport=transport, base_url="http://plant.example") as client:
        assert await sign_in(client, password="wrong") == 401
    assert order == ["answered", "event_sign_in_refused"]


def until_closed(socket: WebSocketTestSession) -> WebSocketDisconnect:
    """Whatever comes, to the end."""
    while True:
        try:
            socket._raise_on_close(socket.receive())
        except WebSocketDisconnect as ended:
            return ended


def test_a_token_that_the_command_line_revokes_stops_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was looked at every 20 s only, which is never here; and a command line is another process."""
    monkeypatch.setattr(Rights.until_withdrawn, "__defaults__", (1e6,))
    app = create_app(settings_in(tmp_path))
    accounts = app.state.services[Accounts]
    with TestClient(app) as client:
        call = client.portal.call  # type: ignore[union-attr]
        token = call(lambda: accounts.create_token("t", Role.WORKER, bus="dry-end", **BY))
        headers = {"authorization": f"Bearer {token}"}
        with client.websocket_connect("/feed", headers=headers) as socket:
            now = time.time()
            socket.send_bytes(encode(Hello(CONTRACT_VERSION, "dry-end", "w", now, "test", "p", now)))
            assert socket.receive()["type"] == "websocket.send"
            with closing(sqlite3.connect(tmp_path / "data" / "lineside.db", timeout=20)) as store:
                store.execute("DELETE FROM tokens")
                store.commit()
            assert until_closed(socket).code == NO_LONGER_SIGNED_IN
        assert client.get("/api/v1/line", headers=headers).status_code == 401
