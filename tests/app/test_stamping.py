"""The stamp of a request at the real sockets of both event loops, and the watch over a loop."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest
import uvicorn
import uvloop
from starlette.types import Receive, Scope, Send
from uvicorn.server import ServerState

from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import ARRIVED_AT, LoopTurns
from app.server.connection import stamping
from app.server.connection.connections import Connections
from app.server.connection.stamping import StampingProtocol
from app.server.connection.tcp_wait import TcpWait, tcp_wait
from app.server.loop_watch import LoopWatch
from tests.app.stage import until

Run = Callable[[Coroutine[Any, Any, None]], None]
ON_EACH_LOOP = pytest.mark.parametrize("run", [asyncio.run, uvloop.run], ids=["asyncio", "uvloop"])
REQUEST = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"


@ON_EACH_LOOP
def test_the_kernel_reports_how_long_bytes_have_waited(run: Run) -> None:
    """Nothing is read here: the bytes stay in the socket, and only the kernel counts."""

    async def at_the_socket() -> None:
        transports: list[asyncio.Transport] = []

        class Deaf(asyncio.Protocol):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                transports.append(cast(asyncio.Transport, transport))
                transports[0].pause_reading()

        server = await asyncio.get_running_loop().create_server(Deaf, "127.0.0.1", 0)
        with socket.create_connection(server.sockets[0].getsockname()) as client:
            await until(lambda: transports, "the connection accepted")

            def wait() -> TcpWait:
                found = tcp_wait(transports[0].get_extra_info("socket"))
                assert found is not None
                return found

            await until(lambda: wait().sent_s >= 0.1, "an age of the connection")

            def has_just_received() -> bool:
                client.sendall(b"x")
                return wait().received_s < 0.1

            await until(has_just_received, "a byte in the socket")
            await until(lambda: wait().received_s >= 0.1, "an age of the byte")
            waits = wait()
            assert waits.sent_s > waits.received_s
            transports[0].close()
        server.close()

    run(at_the_socket())


def test_without_the_systems_report_nothing_is_assumed() -> None:
    one, other = socket.socketpair()
    with one, other:
        assert tcp_wait(one) is None
    assert tcp_wait(one) is None
    assert tcp_wait(None) is None


async def test_a_loop_that_turns_is_seen_to_turn_and_a_stall_is_seen() -> None:
    now = 5000.0
    watch = LoopWatch(lambda: now)
    assert watch.polled_after == float("-inf")
    watch.start()
    try:
        await until(lambda: watch.polled_after == 5000.0, "two ticks")
        now = 5004.0
        assert watch.polled_after == 5000.0
        await until(lambda: watch.polled_after == 5004.0, "the loop known to turn again")
    finally:
        watch.stop()


@asynccontextmanager
async def served(stamps: list[float], watch: LoopWatch) -> AsyncIterator[socket.socket]:
    """A client of a server that notes the stamp of each request."""

    async def note(scope: Scope, _receive: Receive, send: Send) -> None:
        stamps.append(scope["state"][ARRIVED_AT])
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
        await send({"type": "http.response.body"})

    config, state = uvicorn.Config(note, lifespan="off", log_level="critical"), ServerState()
    loop = asyncio.get_running_loop()
    server = await loop.create_server(
        lambda: StampingProtocol(
            config,
            state,
            {},
            watch=watch,
            open_connections=Connections(),
            turns=LoopTurns(),
            refusals=RefusalLog(),
        ),
        "127.0.0.1",
        0,
    )
    client = socket.create_connection(server.sockets[0].getsockname())
    await until(lambda: state.connections, "the connection accepted")
    try:
        yield client
    finally:
        client.close()
        server.close()


class PlayedWatch(LoopWatch):
    """Returns the delay that the test sets."""

    at = polled_at = 0.0

    def __init__(self) -> None:
        super().__init__(lambda: self.at)

    @property
    def polled_after(self) -> float:
        return self.polled_at


async def test_each_request_has_the_stamp_of_its_first_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two in one read the same; of one in two reads that of the first."""
    monkeypatch.setattr(stamping, "tcp_wait", lambda _: None)
    stamps: list[float] = []
    watch = PlayedWatch()
    async with served(stamps, watch) as client:
        watch.at, watch.polled_at = 5000.0, 4999.99
        client.sendall(REQUEST)
        await until(lambda: len(stamps) == 1, "the first request")
        watch.at, watch.polled_at = 5010.0, 5006.0
        client.sendall(REQUEST + REQUEST + REQUEST[:9])
        await until(lambda: len(stamps) == 3, "two at once, after a stall")
        watch.at, watch.polled_at = 5020.0, 5019.99
        client.sendall(REQUEST[9:])
        await until(lambda: len(stamps) == 4, "the rest of the last")
    assert stamps == [5000.0, 5006.0, 5006.0, 5006.0]
