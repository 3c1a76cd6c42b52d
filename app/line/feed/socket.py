"""The WebSocket ``/feed``, to which workers connect with a bearer token, and which leads each to its bus."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect, WebSocketState

from app.core.server.connections import client_connection
from app.core.web.access import Worker
from app.core.web.services import service_of
from app.errors import Problem
from app.line.feed.bus_feed import BusFeed, Credential, WorkerConnection, WorkerLeft, refusal, send_away
from app.line.live.change_recorder import ChangeRecorder
from app.line.pipeline import refusal_of_worker
from app.settings import Settings
from bus.contract import AppMessage, Hello, MalformedMessageError, decode_from_worker, encode
from bus.instants import monotonic_now, unix_now
from bus.messages import Message
from bus.pacing import Bucket

TOO_OFTEN = "this bus was connected to too often; wait a minute"
HELLO_WITHIN_S = 10.0
HELLOS_PER_S, MAX_HELLOS_AT_ONCE = 0.5, 20.0


class Workers:
    """The connections of workers until each has its bus. ``feeds``: by bus; ``recorder``: that of the site,
    for a worker whose bus is not configured."""

    def __init__(self, feeds: Mapping[str, BusFeed], recorder: ChangeRecorder) -> None:
        self._feeds = feeds
        self._recorder = recorder
        self.monotonic = monotonic_now
        self._hello_buckets: defaultdict[str, Bucket] = defaultdict(
            lambda: Bucket(HELLOS_PER_S, MAX_HELLOS_AT_ONCE)
        )
        """The hellos by token, so that none uses up the share of another."""
        self._own_called: set[str] = set()
        """Buses whose own worker connected since `responds` was last called."""

    def responds(self, bus: str) -> bool:
        """Return whether this server's child for ``bus`` is linked, or connected since the last call: a child
        whose bus another worker has is refused, and tries again."""
        called = bus in self._own_called
        self._own_called.discard(bus)
        return called or self._feeds[bus].has_own_worker

    async def serve(self, socket: WorkerConnection, credential: Credential) -> None:
        """Serve one connection from its hello to its end. Raise nothing that a worker could cause."""
        if credential.own:
            self._own_called.add(credential.bus)
        try:
            hello = await self._hello(socket, credential)
            await self._admit(hello, socket, credential)
        except (MalformedMessageError, TimeoutError) as error:
            await socket.close(str(error) or "the first message of a worker is Hello")
        except ConnectionError:
            return

    async def _hello(self, socket: WorkerConnection, credential: Credential) -> Hello:
        if self._hello_buckets[credential.token].pour(1.0, self.monotonic()) > 0.0:
            raise MalformedMessageError(TOO_OFTEN)
        async with asyncio.timeout(HELLO_WITHIN_S):
            data = await socket.receive()
        hello = decode_from_worker(data)
        if not isinstance(hello, Hello):
            raise MalformedMessageError("the first message of a worker is Hello")
        return hello

    async def _admit(self, hello: Hello, socket: WorkerConnection, credential: Credential) -> None:
        feed = self._feeds.get(credential.bus)
        refused = refusal(hello, credential, self._feeds)
        if feed is None:
            assert refused is not None  # the token's bus is not configured
            self._recorder.note(refusal_of_worker(unix_now(), "", str(credential), refused))
            await send_away(socket, refused, unix_now())
        else:
            await feed.serve(hello, socket, credential, refused)


router = APIRouter()

GOING_AWAY = 1001
POLICY_VIOLATION = 1008
SEND_WITHIN_S = 5.0
"""Limits a worker that does not read: it must delay neither commands nor the end of its connection."""
REASON_BYTES = 123
"""The bytes that a close frame has room for (RFC 6455, 5.5)."""


class WorkerSocket:
    """An adapter of Starlette's WebSocket to :class:`app.line.feed.bus_feed.WorkerConnection`."""

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket = websocket

    async def send(self, message: AppMessage) -> None:
        """Send one message. Raise ConnectionError if the worker is gone, or does not read."""
        try:
            async with asyncio.timeout(SEND_WITHIN_S):
                await self._websocket.send_bytes(encode(message))
        except (WebSocketDisconnect, RuntimeError, TimeoutError) as error:
            raise ConnectionError("the bus worker disconnected") from error

    async def receive(self) -> bytes:
        """Return the next message. Raise ConnectionError at the end (WorkerLeft if the worker announced it),
        MalformedMessageError for anything but bytes."""
        if self._websocket.application_state is not WebSocketState.CONNECTED:
            raise ConnectionError("the connection was closed")
        message = await self._websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise (
                WorkerLeft()
                if message.get("code") == GOING_AWAY
                else ConnectionError("the bus worker disconnected")
            )
        data = message.get("bytes")
        if not isinstance(data, bytes):
            raise MalformedMessageError("a worker speaks in binary messages")
        return data

    def admit(self) -> None:
        """Accept the large messages that follow Hello."""
        client_connection(self._websocket.scope).trust()

    async def close(self, reason: str) -> None:
        """End the connection with as many words as a close frame holds; do nothing if it has ended."""
        if self._websocket.application_state is not WebSocketState.CONNECTED:
            return
        short = reason.encode()[:REASON_BYTES].decode(errors="ignore")
        with suppress(WebSocketDisconnect, RuntimeError, TimeoutError):
            async with asyncio.timeout(SEND_WITHIN_S):
                await self._websocket.close(POLICY_VIOLATION, short)


def _check_certificate(websocket: WebSocket) -> None:
    """Require a certificate. Raise Problem 403 for a worker elsewhere without the certificate that
    ``client_ca`` demands."""
    tls = service_of(websocket, Settings).server.tls
    is_demanded = tls is not None and tls.client_ca is not None
    if is_demanded and not client_connection(websocket.scope).is_certified():
        raise Problem(403, "forbidden", Message("worker_certificate_missing"))


@router.websocket("/feed")
async def feed(websocket: WebSocket, worker: Worker) -> None:
    """Serve one worker from its hello to its end. Raise Problem 403 for a token without a bus, and for a
    worker without the certificate that it needs."""
    if not worker.bus:
        raise Problem(
            403,
            "forbidden",
            Message.of("worker_token_without_bus", called=worker.name),
        )
    if worker.via != "worker":
        _check_certificate(websocket)
    await websocket.accept()
    address = websocket.client.host if websocket.client else ""
    credential = Credential(worker.name, worker.bus, address, own=worker.via == "worker")
    await service_of(websocket, Workers).serve(WorkerSocket(websocket), credential)
