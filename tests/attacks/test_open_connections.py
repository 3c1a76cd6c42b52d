"""An open page and an open stream end with the session or the right that opened them, without a look by time.

They went on for up to 20 s after a sign-out, and a stream until its next heartbeat.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.line.live.bus_live import LiveState
from app.people.auth import rights
from app.people.auth.accounts import Accounts
from app.people.auth.identify import NO_LONGER_SIGNED_IN, Identity
from app.people.auth.rights import Rights
from tests.administrator import BY
from tests.app.complete_app import HOST, PASSWORD, House, complete_app
from tests.app.fake_worker import snapshot, until
from tests.attacks.withdrawals import in_another_process, withdraw
from tests.for_each import for_each
from tests.sizes import in_turn

NEVER_S = 1e6
PATHS = ["/live", "/api/v1/stream", "/api/v1/stream?bus=dry-end"]
WAYS = ["demoted", "removed", "disabled", "admitted again", "another password"]


@pytest.fixture
async def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[House]:
    """Nothing is looked at by time, neither by a connection nor by the server."""
    monkeypatch.setattr(Rights.until_withdrawn, "__defaults__", (NEVER_S,))
    monkeypatch.setattr(rights, "WATCH_EVERY_S", NEVER_S)
    async with complete_app(tmp_path) as house:
        house.services[LiveState].buses["dry-end"].connect_worker(snapshot())
        await house.add("boss", Role.ADMIN)
        yield house


@dataclass
class Connection:
    """What came so far of an open WebSocket or stream."""

    sent: list[dict[str, Any]] = field(default_factory=list)
    task: asyncio.Future[None] | None = None

    @property
    def is_over(self) -> bool:
        assert self.task is not None
        return self.task.done()


@asynccontextmanager
async def opened(house: House, path: str, headers: dict[str, str]) -> AsyncIterator[Connection]:
    """Open ``path`` as a server does, and wait for the first values."""
    connection, is_socket = Connection(), path == "/live"
    first = {"type": "websocket.connect"} if is_socket else {"type": "http.request", "body": b""}
    received = [first]

    async def receive() -> dict[str, Any]:
        return received.pop() if received else await asyncio.Future()

    async def send(message: Any) -> None:
        connection.sent.append(message)

    path, _, query = path.partition("?")
    scope = {
        "type": "websocket" if is_socket else "http",
        "asgi": {"version": "3.0", "spec_version": "2.4"},
        "http_version": "1.1",
        "method": "GET",
        "scheme": "ws" if is_socket else "http",
        "path": path,
        "raw_path": path.encode(),
        "query_string": query.encode(),
        "subprotocols": [],
        "headers": [(name.encode(), value.encode()) for name, value in {"host": HOST, **headers}.items()],
        "client": ("192.0.2.7", 4711),
        "server": (HOST, 80),
    }
    connection.task = asyncio.ensure_future(house.app(scope, receive, send))
    await until(lambda: len(connection.sent) >= 2, f"values of {path}")
    try:
        yield connection
    finally:
        connection.task.cancel()
        await asyncio.wait({connection.task})


async def over(connection: Connection) -> None:
    """Wait for its end, which the client sees as one before the end of the content."""
    await until(lambda: connection.is_over, "the end of the connection")
    assert connection.task is not None
    assert connection.task.exception() is None
    last = connection.sent[-1]
    assert last.get("code") == NO_LONGER_SIGNED_IN or last.get("more_body")


def cookies_of(client: httpx.AsyncClient) -> dict[str, str]:
    return {"cookie": "; ".join(f"{name}={value}" for name, value in client.cookies.items())}


@pytest.mark.parametrize(("how", "path"), in_turn(WAYS, PATHS))
async def test_it_ends_when_the_rights_of_its_user_are_withdrawn(house: House, path: str, how: str) -> None:
    client = await house.signed_in(Role.OPERATOR, "ann")
    async with opened(house, path, cookies_of(client)) as connection:
        await withdraw(house, how, "ann")
        await over(connection)


@for_each("path", PATHS)
async def test_it_ends_with_its_token(house: House, path: str) -> None:
    token = await house.services[Accounts].create_token("plc", Role.VIEWER, **BY)
    async with opened(house, path, {"authorization": f"Bearer {token}"}) as connection:
        await house.services[Accounts].revoke_token("plc", **BY)
        await over(connection)


@for_each("path", PATHS)
async def test_it_ends_with_a_sign_out_and_another_session_goes_on(house: House, path: str) -> None:
    client = await house.signed_in(Role.OPERATOR, "ann")
    other = house.client()
    assert (await other.post("/login", data={"name": "ann", "password": PASSWORD})).status_code == 303
    async with (
        opened(house, path, cookies_of(client)) as connection,
        opened(house, path, cookies_of(other)) as going_on,
    ):
        assert (await client.post("/logout")).status_code == 303
        await over(connection)
        assert not going_on.is_over
        assert (await other.post("/logout")).status_code == 303
        await over(going_on)


@pytest.mark.parametrize("path", PATHS[:2])
async def test_it_ends_for_the_sessions_that_a_new_password_ends_and_not_for_the_one_that_chose_it(
    house: House, path: str
) -> None:
    client = await house.signed_in(Role.OPERATOR, "ann")
    other = house.client()
    assert (await other.post("/login", data={"name": "ann", "password": PASSWORD})).status_code == 303
    form = {"present": PASSWORD, "password": f"x{PASSWORD}", "again": f"x{PASSWORD}"}
    async with (
        opened(house, path, cookies_of(client)) as chose,
        opened(house, path, cookies_of(other)) as connection,
    ):
        assert (await client.post("/account/password", data=form)).status_code == 303
        await over(connection)
        assert not chose.is_over


@pytest.mark.parametrize("path", PATHS[:2])
async def test_it_ends_after_a_change_by_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    """Another process: the server looks at its store twice a second, the connection at nothing."""
    monkeypatch.setattr(Rights.until_withdrawn, "__defaults__", (NEVER_S,))
    async with complete_app(tmp_path) as house:
        house.services[LiveState].buses["dry-end"].connect_worker(snapshot())
        client = await house.signed_in(Role.OPERATOR, "ann")
        async with opened(house, path, cookies_of(client)) as connection:
            in_another_process(house, "UPDATE users SET disabled = 1 WHERE name = 'ann'")
            await over(connection)


async def test_a_right_withdrawn_while_a_page_opens_ends_it(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look at the cookie and the first value."""
    client = await house.signed_in(Role.OPERATOR, "ann")
    by_cookie, identity = house.services[Identity].by_cookie, house.services[Identity]

    async def found_and_then_removed(*args: Any, **options: Any) -> Any:
        person = await by_cookie(*args, **options)
        if person is not None:
            await house.services[Accounts].remove_user("ann", **BY)
        return person

    monkeypatch.setattr(identity, "by_cookie", found_and_then_removed)
    async with opened(house, "/live", cookies_of(client)) as connection:
        await over(connection)
