"""Callers who never come to the end of what they ask."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from uvicorn.server import ServerState

from app.cli import patience
from app.cli.patience import MOST_HEAD_BYTES, PatientProtocol

HEAD = b"GET / HTTP/1.1\r\nHost: here\r\n"
LONG_S = 30.0
Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def hello(_scope: Scope, receive: Receive, send: Send) -> None:
    while (await receive()).get("more_body"):
        pass
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"hi"})


@asynccontextmanager
async def connected() -> AsyncIterator[Ends]:
    """To a server of this protocol."""
    config, state = uvicorn.Config(hello, lifespan="off", log_level="critical"), ServerState()
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: PatientProtocol(config, state, {}), "127.0.0.1", 0)
    reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
    yield reader, writer
    writer.close()
    server.close()


async def everything(reader: asyncio.StreamReader) -> bytes:
    """Until the server closes."""
    return await asyncio.wait_for(reader.read(), LONG_S)


@pytest.mark.parametrize(("begun", "heard"), [(b"", b""), (HEAD, b""), (HEAD + b"\r\n" + HEAD, b"200 OK")])
async def test_what_is_never_finished_is_not_waited_for_for_ever(
    monkeypatch: pytest.MonkeyPatch, begun: bytes, heard: bytes
) -> None:
    monkeypatch.setattr(patience, "HEAD_WITHIN_S", 0.1)
    async with connected() as (reader, writer):
        writer.write(begun)
        assert heard in await everything(reader)


async def test_headers_without_end_are_refused() -> None:
    async with connected() as (reader, writer):
        writer.write(HEAD + b"X: " + b"a" * MOST_HEAD_BYTES)
        assert b"400 Bad Request" in await everything(reader)


async def test_a_whole_request_is_answered_and_its_body_is_no_header() -> None:
    body = b"b" * (2 * MOST_HEAD_BYTES)
    head = b"POST / HTTP/1.1\r\nConnection: close\r\nContent-Length: %d\r\n\r\n" % len(body)
    async with connected() as (reader, writer):
        writer.write(head + body)
        assert b"200 OK" in await everything(reader)
