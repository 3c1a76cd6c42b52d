"""A socket ends when its user loses the right to it."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from app.auth.lasting import (
    NO_LONGER_SIGNED_IN,
    Rechecks,
    RightsEndedError,
    sending_while_allowed,
    while_allowed,
)
from app.main import create_app
from app.web.access import Role
from tests.app.complete_app import settings_in


class Socket:
    """Notes what is sent."""

    def __init__(self) -> None:
        self.sent: list[MutableMapping[str, Any]] = []
        self.ended = False

    async def send(self, message: MutableMapping[str, Any]) -> None:
        self.sent.append(message)

    async def work(self) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            self.ended = True


async def test_it_ends_with_its_right() -> None:
    socket, permitted = Socket(), iter([True, True, False])

    async def is_allowed() -> bool:
        return next(permitted)

    await while_allowed(socket.work(), is_allowed, socket.send, Rechecks(), every_s=0.001)
    assert socket.ended
    assert socket.sent == [{"type": "websocket.close", "code": NO_LONGER_SIGNED_IN}]


async def test_a_socket_that_ended_is_not_closed_again() -> None:
    socket = Socket()

    async def short() -> None:
        return None

    async def is_allowed() -> bool:
        return True

    await while_allowed(short(), is_allowed, socket.send, Rechecks())
    assert socket.sent == []


async def test_a_failure_comes_through() -> None:
    async def fail() -> None:
        raise ZeroDivisionError

    async def is_allowed() -> bool:
        return True

    with pytest.raises(ZeroDivisionError):
        await while_allowed(fail(), is_allowed, Socket().send, Rechecks())


async def test_a_server_that_ends_takes_it_along() -> None:
    socket = Socket()

    async def is_allowed() -> bool:
        return True

    task = asyncio.ensure_future(while_allowed(socket.work(), is_allowed, socket.send, Rechecks()))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert socket.ended


def read_to_the_end(socket: WebSocketTestSession) -> None:
    while True:
        socket.receive_text()


async def test_it_is_looked_at_again_when_rights_change() -> None:
    socket, rechecks, allowed = Socket(), Rechecks(), True

    async def is_allowed() -> bool:
        return allowed

    task = asyncio.ensure_future(while_allowed(socket.work(), is_allowed, socket.send, rechecks))
    await asyncio.sleep(0)
    rechecks.now()
    for _ in range(10):
        await asyncio.sleep(0)
    assert not task.done()
    allowed = False
    rechecks.now()
    async with asyncio.timeout(60):
        await task
    assert socket.ended


async def test_a_change_during_a_look_is_looked_at_too() -> None:
    socket, rechecks, looks = Socket(), Rechecks(), 0

    async def is_allowed() -> bool:
        nonlocal looks
        looks += 1
        if looks == 1:
            rechecks.now()
            return True
        return False

    task = asyncio.ensure_future(while_allowed(socket.work(), is_allowed, socket.send, rechecks))
    await asyncio.sleep(0)
    rechecks.now()
    async with asyncio.timeout(60):
        await task
    assert looks == 2


async def test_a_response_in_pieces_ends_with_its_right() -> None:
    socket, rechecks, allowed = Socket(), Rechecks(), True

    async def is_allowed() -> bool:
        return allowed

    send = sending_while_allowed(socket.send, is_allowed, rechecks)
    piece = {"type": "http.response.body", "body": b"x", "more_body": True}
    await send(piece)
    allowed = False
    await send(piece)
    rechecks.now()
    with pytest.raises(RightsEndedError):
        await send(piece)
    assert len(socket.sent) == 2


def test_a_revoked_token_loses_its_open_page(tmp_path: Path) -> None:
    """It was looked at every 20 s."""
    app = create_app(settings_in(tmp_path))
    accounts = app.state.services.accounts
    by = {"by": "t", "origin": "t"}
    with TestClient(app) as client:
        call = client.portal.call  # type: ignore[union-attr]
        token = call(lambda: accounts.create_token("t", Role.VIEWER, **by))
        with client.websocket_connect("/live", headers={"authorization": f"Bearer {token}"}) as socket:
            socket.receive_text()
            call(lambda: accounts.revoke_token("t", **by))
            with pytest.raises(WebSocketDisconnect) as ended:
                read_to_the_end(socket)
    assert ended.value.code == NO_LONGER_SIGNED_IN
