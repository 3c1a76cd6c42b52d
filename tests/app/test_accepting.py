"""Connections are accepted a few in each iteration of the event loop."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import AsyncIterator

import pytest

from app.server.connection.accepting import MAX_AT_ONCE, accept_connections

COUNT = 50


class Greeting(asyncio.Protocol):
    """Sends hello, and closes."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.write(b"hello")
        transport.close()


class Counted(Greeting):
    """Notes in which iteration it was made."""

    made: list[int]
    iteration = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        type(self).made.append(type(self).iteration)
        super().connection_made(transport)


@pytest.fixture
async def listening() -> AsyncIterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0), backlog=2 * COUNT) as listening:
        yield listening


async def greeted(port: int) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        return await reader.read()
    finally:
        writer.close()


async def test_a_burst_is_spread_over_iterations(listening: socket.socket) -> None:
    Counted.made, Counted.iteration = [], 0
    clients = [socket.create_connection(listening.getsockname()) for _ in range(COUNT)]
    accepting = asyncio.create_task(accept_connections(listening, Counted))
    async with asyncio.timeout(30):
        while len(Counted.made) < COUNT:
            Counted.iteration += 1
            await asyncio.sleep(0)
    accepting.cancel()
    assert max(Counter(Counted.made).values()) <= MAX_AT_ONCE < COUNT
    for client in clients:
        assert client.recv(10) == b"hello"
        client.close()


async def test_it_goes_on_after_a_client_that_is_gone_and_where_no_file_is_left(
    listening: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, faults = asyncio.get_running_loop(), [ConnectionAbortedError(), OSError(24, "Too many open files")]
    accept = loop.sock_accept

    async def failing(sock: socket.socket) -> tuple[socket.socket, object]:
        if faults:
            raise faults.pop(0)
        return await accept(sock)

    monkeypatch.setattr(loop, "sock_accept", failing)
    accepting = asyncio.create_task(accept_connections(listening, Greeting))
    async with asyncio.timeout(30):
        assert await greeted(listening.getsockname()[1]) == b"hello"
    assert faults == []
    accepting.cancel()
