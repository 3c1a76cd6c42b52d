"""Ports that fail at the worst moment: none of it leaves a traceback in the log or an open descriptor."""

from __future__ import annotations

import asyncio
import gc
import os
import pty
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from bus.errors import WireError
from bus.line.opener import open_port
from bus.line.port import EndedWhileOpening, OpenPort, PortUnavailable
from tests.bus.test_open_port import POLL, Receiver, on_both_loops

PATIENCE_S = 60.0
MODEM_STATE_WITHOUT_STATE = b"\xff\xfa\x2c\x6b\xff\xf0"
"""IAC SB COM-PORT-OPTION NOTIFY-MODEMSTATE IAC SE: RFC 2217, 3 wants one more byte."""
NO_SUCH_PARITY = b"\xff\xfa\x2c\x67\x63\xff\xf0"
IMPOSSIBLE_HOSTS = ["a..b", "x" * 64]


@asynccontextmanager
async def nothing_printed() -> AsyncIterator[None]:
    """Fails where the event loop would print a traceback, now or when objects are collected."""
    faults: list[dict[str, Any]] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: faults.append(context))
    try:
        yield
        for _ in range(5):
            gc.collect()
            await asyncio.sleep(0)
    finally:
        loop.set_exception_handler(None)
    assert faults == []


def descriptors() -> int:
    """How many this process has open."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


@on_both_loops
async def test_a_port_that_is_closed_while_its_loss_is_on_the_way() -> None:
    """The transport reports the loss in the loop's next turn: it must not be closed twice."""
    async with nothing_printed():
        master, slave = pty.openpty()
        receiver = Receiver()
        port: Any = await open_port(os.ttyname(slave), 9600, receiver)
        os.close(slave)
        os.close(master)
        loop = asyncio.get_running_loop()
        closed = loop.create_future()

        def close_when_closing() -> None:
            if port._transport.is_closing():
                port.close()
                closed.set_result(None)
            else:
                loop.call_soon(close_when_closing)

        loop.call_soon(close_when_closing)
        async with asyncio.timeout(PATIENCE_S):
            await closed
        await asyncio.sleep(0.01)
        assert receiver.lost == [], "closing a port does not report it as lost"


@on_both_loops
async def test_a_cable_pulled_at_any_moment_of_a_write() -> None:
    async with nothing_printed():
        before = descriptors()
        for turns in range(12):
            master, slave = pty.openpty()
            port = await open_port(os.ttyname(slave), 9600, Receiver())
            os.close(slave)
            port.write(POLL)
            os.close(master)
            for _ in range(turns):
                await asyncio.sleep(0)
            with suppress(WireError):
                port.write(POLL)
            port.close()
        await asyncio.sleep(0.01)
        gc.collect()
        assert descriptors() <= before


@on_both_loops
async def test_opening_that_is_given_up_leaves_nothing_open() -> None:
    async with nothing_printed():
        master, slave = pty.openpty()
        name, before = os.ttyname(slave), descriptors()
        for turns in range(4):
            opening = asyncio.create_task(open_port(name, 9600, Receiver()))
            for _ in range(turns):
                await asyncio.sleep(0)
            opening.cancel()
            with suppress(asyncio.CancelledError):
                (await opening).close()
            await asyncio.sleep(0.01)
        gc.collect()
        assert descriptors() <= before
        os.close(master)
        os.close(slave)


# --- device servers ---------------------------------------------------------------------------------


@asynccontextmanager
async def server_that(respond: Any) -> AsyncIterator[int]:
    """Run a TCP server that calls ``respond(reader, writer)`` for each connection; yield its port number."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError):
            await respond(reader, writer)
        writer.transport.abort()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


async def closes_at_once(_reader: asyncio.StreamReader, _writer: asyncio.StreamWriter) -> None:
    """Accepts and closes."""


async def resets(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Ends with a reset after the first bytes."""
    await reader.read(1)
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


async def talks_nonsense(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Respond with commands that have no value, or an impossible one."""
    await reader.read(1)
    writer.write(MODEM_STATE_WITHOUT_STATE + NO_SUCH_PARITY)
    await reader.read()


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
@pytest.mark.parametrize("fault", [closes_at_once, resets, talks_nonsense])
@on_both_loops
async def test_a_device_server_that_fails(scheme: str, fault: Any) -> None:
    async with nothing_printed(), server_that(fault) as number:
        for _ in range(5):
            port: OpenPort | None = None
            with suppress(WireError):
                port = await open_port(f"{scheme}://127.0.0.1:{number}", 9600, Receiver())
                for _ in range(20):
                    port.write(POLL)
                    await asyncio.sleep(0.001)
            if port is not None:
                port.close()


async def test_a_server_that_ends_its_negotiation_is_distinguished_from_an_absent_one() -> None:
    """The one is tried ever more seldom, the other is looked for twice a second."""

    async def hang_up(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    async with server_that(hang_up) as number:
        with pytest.raises(EndedWhileOpening):
            await open_port(f"rfc2217://127.0.0.1:{number}", 9600, Receiver())
    with pytest.raises(PortUnavailable) as absent:
        await open_port(f"rfc2217://127.0.0.1:{number}", 9600, Receiver())
    assert type(absent.value) is PortUnavailable


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
@pytest.mark.parametrize("host", IMPOSSIBLE_HOSTS)
async def test_a_host_that_does_not_exist_is_a_port_that_cannot_be_opened(scheme: str, host: str) -> None:
    async with nothing_printed():
        with pytest.raises(PortUnavailable, match=f"{scheme}://{host}"):
            await open_port(f"{scheme}://{host}:4001", 9600, Receiver())


def accepted(command: int, *value: int) -> bytes:
    """IAC SB COM-PORT-OPTION command value IAC SE."""
    return bytes((0xFF, 0xFA, 0x2C, command, *value, 0xFF, 0xF0))


NEGOTIATION = (
    b"\xff\xfd\x00\xff\xfb\x00\xff\xfd\x2c"  # IAC DO BINARY, IAC WILL BINARY, IAC DO COM-PORT-OPTION
    + accepted(101, 0, 0, 0x25, 0x80)  # 9600 baud
    + accepted(102, 8)
    + accepted(103, 1)
    + accepted(104, 1)
    + accepted(105, 1)
)
"""All that a device server sends until the port is open (RFC 2217, 3)."""


@on_both_loops
async def test_a_device_server_that_dies_at_any_byte_of_its_negotiation() -> None:
    async with nothing_printed():
        opened = []
        for count in range(len(NEGOTIATION) + 1):

            async def dies(
                reader: asyncio.StreamReader, writer: asyncio.StreamWriter, count: int = count
            ) -> None:
                await reader.read(1)
                writer.write(NEGOTIATION[:count])
                await writer.drain()
                writer.close()
                await writer.wait_closed()

            async with server_that(dies) as number:
                with suppress(PortUnavailable):
                    port = await open_port(f"rfc2217://127.0.0.1:{number}", 9600, Receiver())
                    opened.append(count)
                    port.close()
        assert set(opened) <= {len(NEGOTIATION)}
