"""A worker that does not read its WebSocket holds nothing up."""

from __future__ import annotations

import asyncio

import pytest
from starlette.types import Message
from starlette.websockets import WebSocket, WebSocketState

from app.line.feed import socket as sockets
from app.line.feed.socket import WorkerSocket
from bus.contract import ClockSync


def unread() -> WebSocket:
    """A WebSocket whose peer reads nothing: every send waits."""

    async def receive() -> Message:
        return await asyncio.Future()

    async def send(_: Message) -> None:
        await asyncio.Future()

    made = WebSocket({"type": "websocket", "path": "/feed", "headers": []}, receive, send)
    made.client_state = made.application_state = WebSocketState.CONNECTED
    return made


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is over at once."""
    monkeypatch.setattr(sockets, "SEND_WITHIN_S", 0.0)


async def test_a_send_without_a_reader_ends_as_a_lost_connection() -> None:
    async with asyncio.timeout(60):
        with pytest.raises(ConnectionError):
            await WorkerSocket(unread()).send(ClockSync(app_time=1.0))


async def test_neither_does_its_close_wait() -> None:
    async with asyncio.timeout(60):
        await WorkerSocket(unread()).close("enough")
