"""Limits of a connection of an OPC UA client, with a transport that the test plays."""

from __future__ import annotations

import asyncio
import logging
import struct
from datetime import UTC, datetime
from pathlib import Path
from unittest.mock import AsyncMock

import pytest
from asyncua import ua
from asyncua.common.utils import ServiceError

from app.system.opcua import gate
from app.system.opcua.access import OwnCertificate, TokenList, TrustList, own_certificate
from app.system.opcua.gate import Gate, GuardedConnection, ViewerServer
from tests.app.fake_worker import until


class PlayedTransport:
    """A transport that notes what is done to it."""

    def __init__(self) -> None:
        self.is_read, self.was_aborted, self.written = True, False, b""

    def get_extra_info(self, name: str) -> tuple[str, int]:
        return ("10.0.0.9" if name == "peername" else "10.0.0.1", 4840)

    def set_write_buffer_limits(self, high: int) -> None:
        assert high == gate.MAX_UNREAD

    def pause_reading(self) -> None:
        self.is_read = False

    def resume_reading(self) -> None:
        self.is_read = True

    def write(self, data: bytes) -> None:
        self.written += data

    def abort(self) -> None:
        self.was_aborted = True

    close = abort

    def is_closing(self) -> bool:
        return self.was_aborted


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnCertificate:
    return own_certificate(tmp_path_factory.mktemp("own"), (), "Mill 7", datetime.now(UTC))


@pytest.fixture
def made(own: OwnCertificate, tmp_path: Path) -> Gate:
    return Gate(ViewerServer(own, TrustList(tmp_path), TokenList()))


@pytest.fixture
def transport() -> PlayedTransport:
    return PlayedTransport()


async def connection_of(made: Gate, transport: PlayedTransport) -> GuardedConnection:
    connection = GuardedConnection(made)
    connection.connection_made(transport)
    return connection


def message(size: int = 16) -> bytes:
    return b"MSGF" + struct.pack("<I", size) + b"\x00" * (size - 8)


async def test_a_client_that_asks_too_often_is_read_again_later(
    made: Gate, transport: PlayedTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "REQUESTS_PER_S", 50.0)
    monkeypatch.setattr(gate, "MAX_REQUESTS_AT_ONCE", 5.0)
    connection = await connection_of(made, transport)
    connection.data_received(message() * 4)
    assert transport.is_read
    connection.data_received(message() * 4)
    assert not transport.is_read
    assert made.server.refusals.by_reason == {"rate": 1}
    await until(lambda: transport.is_read, "it is read again")
    connection.data_received(message(8 * gate.REQUEST_BYTES))
    assert not transport.is_read, "a large message counts as several"
    connection.connection_lost(None)


async def test_a_client_that_does_not_read_is_not_read_and_given_up(
    made: Gate, transport: PlayedTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = await connection_of(made, transport)
    connection.pause_writing()
    assert not transport.is_read
    connection.resume_writing()
    assert transport.is_read
    monkeypatch.setattr(gate, "READ_WITHIN_S", 0.01)
    connection.pause_writing()
    await until(lambda: transport.was_aborted, "it is given up")
    connection.connection_lost(None)


async def test_a_socket_that_is_not_read_and_one_without_a_session_are_given_up(
    made: Gate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "READ_WITHIN_S", 0.01)
    server = await made.bind("127.0.0.1", 0)
    await server.start_serving()
    port = server.sockets[0].getsockname()[1]
    ends = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
    ends[0][1].transport.pause_reading()
    await until(lambda: len(made.connections) == 2, "both are accepted")
    (unread,) = (each for each in made.connections if each.peer_name == ends[0][1].get_extra_info("sockname"))
    assert unread.transport is not None
    unread.transport.write(bytes(20 * gate.MAX_UNREAD))
    await until(lambda: unread not in made.connections, "it is given up")
    assert made.server.refusals.by_reason == {"does not read": 1}
    monkeypatch.setattr(gate, "SWEEP_S", 0.01)
    monkeypatch.setattr(gate, "SIGN_IN_S", 0.0)
    sweeping = asyncio.create_task(made.sweep())
    await until(lambda: not made.connections, "the other is given up")
    assert made.server.refusals.by_reason["no session"] == 1
    sweeping.cancel()
    for _, writer in ends:
        writer.transport.abort()
    server.close()


async def test_a_message_in_pieces_is_one(made: Gate, transport: PlayedTransport) -> None:
    connection = await connection_of(made, transport)
    for byte in message(20):
        connection.data_received(bytes([byte]))
    assert connection.messages.qsize() == 1
    assert transport.written == b""
    connection.data_received(message()[:7])
    assert connection.messages.qsize() == 1
    connection.connection_lost(None)


async def test_what_waits_to_be_done_is_bounded(made: Gate, transport: PlayedTransport) -> None:
    connection = await connection_of(made, transport)
    connection.data_received(message() * (gate.MAX_PENDING + 1))
    assert transport.was_aborted
    connection.connection_lost(None)


async def test_a_session_that_is_not_read_does_nothing_meanwhile(made: Gate) -> None:
    session = made.server.create_session("client", external=True)
    session.reads.clear()
    waiting = asyncio.create_task(session.translate_browsepaths_to_nodeids([]))
    await asyncio.sleep(0)
    assert not waiting.done()
    session.reads.set()
    assert await waiting == []


async def test_a_connection_has_one_session_and_there_are_not_too_many(made: Gate) -> None:
    made.server.create_session("one", external=True)
    with pytest.raises(ServiceError):
        made.server.create_session("one", external=True)
    for number in range(gate.MAX_SESSIONS - 1):
        made.server.create_session(f"of {number}", external=True)
    with pytest.raises(ServiceError):
        made.server.create_session("another", external=True)
    await next(iter(made.server.sessions.values())).close_session()
    made.server.create_session("another", external=True)


async def test_no_logger_is_left_of_a_subscription(made: Gate) -> None:
    session = made.server.create_session("client", external=True)
    params = ua.CreateSubscriptionParameters()
    await session.create_subscription(params, AsyncMock())
    loggers = logging.root.manager.loggerDict
    assert any(name.startswith(gate.LOGGERS) for name in loggers), "asyncua makes none any more"
    gate.forget_loggers()
    assert isinstance(loggers[gate.LOGGERS.rstrip(".")], logging.Logger), "it has no list of them"
    assert not any(name.startswith(gate.LOGGERS) for name in loggers)
    await session.close_session()
