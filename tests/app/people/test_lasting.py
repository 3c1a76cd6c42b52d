"""A socket ends when its user loses the right to it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.types import Send
from starlette.websockets import WebSocketDisconnect

from app.core.web.access import Role
from app.main import create_app
from app.people.auth.accounts import Accounts
from app.people.auth.identify import NO_LONGER_SIGNED_IN, run_while_allowed
from app.people.auth.rights import Rights
from tests.administrator import BY
from tests.app.complete_app import settings_in

NEVER_S = 1e6


class Socket:
    """Notes what is sent."""

    def __init__(self) -> None:
        self.sent: list[MutableMapping[str, Any]] = []
        self.ended = False

    async def send(self, message: MutableMapping[str, Any]) -> None:
        self.sent.append(message)

    async def work(self, _send: Send) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            self.ended = True


@dataclass
class Right:
    """Of one connection; a test takes it away. ``looks``: how often it was looked up."""

    rights: Rights = field(default_factory=lambda: Rights(None))  # type: ignore[arg-type]
    is_good: bool = True
    looks: int = 0
    on_look: Callable[[], None] = lambda: None

    async def is_allowed(self) -> bool:
        self.looks += 1
        found = self.is_good
        self.on_look()
        return found

    async def withdrawn(self, every_s: float = NEVER_S) -> None:
        await self.rights.until_withdrawn(self.is_allowed, 0, every_s)

    def withdraw(self) -> None:
        self.is_good = False
        self.rights.announce()


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def ended(task: asyncio.Future[None]) -> None:
    async with asyncio.timeout(60):
        await task


async def test_it_ends_with_its_right() -> None:
    socket, right = Socket(), Right()
    task = asyncio.ensure_future(run_while_allowed(socket.work, right.withdrawn, socket.send, is_socket=True))
    await settled()
    right.withdraw()
    await ended(task)
    assert socket.ended
    assert socket.sent == [{"type": "websocket.close", "code": NO_LONGER_SIGNED_IN}]


async def test_what_ends_without_a_change_is_noticed_in_time() -> None:
    right = Right(is_good=False)
    await ended(asyncio.ensure_future(right.withdrawn(every_s=0.001)))
    assert right.looks == 1


async def test_a_socket_that_ended_is_not_closed_again() -> None:
    socket = Socket()

    async def short(_: Send) -> None:
        return None

    await run_while_allowed(short, Right().withdrawn, socket.send, is_socket=True)
    assert socket.sent == []


async def test_a_failure_comes_through() -> None:
    async def fail(_: Send) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await run_while_allowed(fail, Right().withdrawn, Socket().send, is_socket=True)


async def test_a_right_that_cannot_be_looked_up_ends_it_with_the_failure() -> None:
    socket, right = Socket(), Right()

    def fail() -> None:
        raise ZeroDivisionError

    right.on_look = fail
    task = asyncio.ensure_future(run_while_allowed(socket.work, right.withdrawn, socket.send, is_socket=True))
    await settled()
    right.rights.announce()
    with pytest.raises(ZeroDivisionError):
        await ended(task)
    assert socket.ended


async def test_a_server_that_ends_takes_it_along() -> None:
    socket = Socket()
    task = asyncio.ensure_future(
        run_while_allowed(socket.work, Right().withdrawn, socket.send, is_socket=True)
    )
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert socket.ended


async def test_it_is_looked_at_when_rights_change() -> None:
    right = Right()
    task = asyncio.ensure_future(right.withdrawn())
    await settled()
    assert right.looks == 0
    for number in (1, 2):
        right.rights.announce()
        await settled()
        assert right.looks == number
    assert not task.done()
    right.withdraw()
    await ended(task)
    right.rights.announce()


async def test_a_change_before_it_was_followed_is_looked_at_too() -> None:
    """The right was looked up, then taken away, and only then was the connection opened."""
    right = Right()
    right.withdraw()
    await ended(asyncio.ensure_future(right.withdrawn()))


async def test_a_change_during_a_look_is_looked_at_too() -> None:
    right = Right()
    task = asyncio.ensure_future(right.withdrawn())
    await settled()
    right.on_look = right.withdraw
    right.rights.announce()
    await ended(task)
    assert right.looks == 2


PIECE = {"type": "http.response.body", "body": b"x", "more_body": True}


@pytest.mark.parametrize("waits_in", ["the next piece", "a slow reader"])
async def test_a_response_in_pieces_ends_with_its_right(waits_in: str) -> None:
    """It was looked at with the next piece, which a line at rest sends every five seconds."""
    socket, right, waiting, left = Socket(), Right(), asyncio.Event(), False

    async def respond(send: Send) -> None:
        nonlocal left
        try:
            await send(PIECE)
            await send(PIECE)
            waiting.set()
            await asyncio.Event().wait()
        finally:
            left = True

    async def slow(message: MutableMapping[str, Any]) -> None:
        await socket.send(message)
        if waits_in == "a slow reader" and len(socket.sent) == 2:
            waiting.set()
            await asyncio.Event().wait()

    task = asyncio.ensure_future(run_while_allowed(respond, right.withdrawn, slow))
    await waiting.wait()
    right.rights.announce()
    await settled()
    assert not task.done(), "its right is good"
    right.withdraw()
    await ended(task)
    assert (left, len(socket.sent)) == (True, 2)


async def test_a_response_that_a_server_cuts_off_is_canceled() -> None:
    async def respond(send: Send) -> None:
        await send(PIECE)
        await asyncio.Event().wait()

    task = asyncio.ensure_future(run_while_allowed(respond, Right().withdrawn, Socket().send))
    await settled()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await ended(task)


async def test_a_response_at_once_is_not_followed() -> None:
    right = Right()
    right.withdraw()

    async def respond(send: Send) -> None:
        await send({"type": "http.response.body", "body": b"x"})
        await settled()

    await run_while_allowed(respond, right.withdrawn, Socket().send)
    assert right.looks == 0


def read_to_the_end(socket: WebSocketTestSession) -> None:
    while True:
        socket.receive_text()


def test_a_revoked_token_loses_its_open_page(tmp_path: Path) -> None:
    """It was looked at every 20 s."""
    app = create_app(settings_in(tmp_path))
    accounts = app.state.services[Accounts]
    with TestClient(app) as client:
        call = client.portal.call  # type: ignore[union-attr]
        token = call(lambda: accounts.create_token("t", Role.VIEWER, **BY))
        with client.websocket_connect("/live", headers={"authorization": f"Bearer {token}"}) as socket:
            socket.receive_text()
            call(lambda: accounts.revoke_token("t", **BY))
            with pytest.raises(WebSocketDisconnect) as ended:
                read_to_the_end(socket)
    assert ended.value.code == NO_LONGER_SIGNED_IN
