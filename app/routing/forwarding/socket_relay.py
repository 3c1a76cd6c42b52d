"""Passes the WebSocket of a page on to the home that the page looks at."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from app.home.homes import Home
from app.routing.forwarding.courier import home_away
from app.routing.forwarding.headers import Pairs, to_client
from app.routing.peers import CONNECT_S, Peers
from app.web.problems import refuse_socket

if TYPE_CHECKING:
    from websockets.asyncio.client import ClientConnection
    from websockets.http11 import Response

OPEN_S = 5.0
MAX_MESSAGE_BYTES = 4 * 1024 * 1024
MAX_WAITING = 2
"""Messages of a home that wait for a slow page, before the home notices that it is slow."""
MAX_DENIAL_BYTES = 64 * 1024
GOING_AWAY = 1001
NEVER_SENT = (1005, 1006, 1015)
"""Close codes that only state how a connection ended (RFC 6455, 7.4.1)."""


class SocketRelay:
    """Relays texts both ways until one side ends."""

    def __init__(self, peers: Peers) -> None:
        self._peers = peers

    async def carry(
        self, home: Home, target: bytes, headers: Pairs, scope: Scope, receive: Receive, send: Send
    ) -> None:
        """The handshake succeeds once that of the home has. A refusal of the home is passed back."""
        from websockets.asyncio.client import connect
        from websockets.exceptions import InvalidStatus, WebSocketException

        url = home.url.rstrip("/").replace("http", "ws", 1) + target.decode("latin-1")
        try:
            async with asyncio.timeout(OPEN_S):
                opened = await connect(
                    url,
                    additional_headers=[(name.decode(), value.decode("latin-1")) for name, value in headers],
                    user_agent_header=None,
                    ssl=self._peers.context if url.startswith("wss:") else None,
                    open_timeout=None,
                    close_timeout=CONNECT_S,
                    ping_interval=None,  # the server of the page sends every second
                    compression=None,
                    proxy=None,
                    max_size=MAX_MESSAGE_BYTES,
                    max_queue=MAX_WAITING,
                )
        except InvalidStatus as refusal:
            await _deny(refusal.response, send)
            return
        except (OSError, TimeoutError, WebSocketException):
            await refuse_socket(WebSocket(scope, receive, send), home_away(home, is_write=False))
            return
        async with opened:
            await receive()  # the handshake of the page
            await send({"type": "websocket.accept"})
            await _relay(opened, receive, send)


async def _relay(opened: ClientConnection, receive: Receive, send: Send) -> None:
    """Until the first of both directions has ended, which ends the other."""
    tasks = {asyncio.create_task(_to_page(opened, send)), asyncio.create_task(_to_home(opened, receive))}
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    code = opened.close_code or GOING_AWAY
    with suppress(RuntimeError, OSError):
        await send({"type": "websocket.close", "code": GOING_AWAY if code in NEVER_SENT else code})


async def _to_page(opened: ClientConnection, send: Send) -> None:
    async for message in opened:
        if isinstance(message, str):
            await send({"type": "websocket.send", "text": message})


async def _to_home(opened: ClientConnection, receive: Receive) -> None:
    while (message := await receive())["type"] == "websocket.receive":
        if isinstance(text := message.get("text"), str):
            await opened.send(text)


async def _deny(response: Response, send: Send) -> None:
    raw: list[Any] = list(response.headers.raw_items())
    headers = to_client((name.encode("latin-1"), value.encode("latin-1")) for name, value in raw)
    body = bytes(response.body or b"")[:MAX_DENIAL_BYTES]
    kept = [pair for pair in headers if pair[0] != b"content-length"]
    start = {"type": "websocket.http.response.start", "status": response.status_code, "headers": kept}
    await send(start)
    await send({"type": "websocket.http.response.body", "body": body})
