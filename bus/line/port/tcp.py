"""A device server that carries the bytes as they are, through asyncio's own transport."""

from __future__ import annotations

import asyncio
import re
import socket
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from bus.errors import WireError
from bus.line.port.port import OpenPort, PortProtocol, PortUnavailable, Receiver
from bus.messages import Message

CONNECT_TIMEOUT_S = 3.0
TCP_LOST_AFTER_MS = 800
"""Unacknowledged bytes for so long mean that the device server is gone."""
MAX_TEXT_BYTES = 400
MAX_SHOWN = 100
_TEXT = re.compile(rb"[\x20-\x7e\r\n\t]+")
_TCP_USER_TIMEOUT = getattr(socket, "TCP_USER_TIMEOUT", 18)


class TcpProtocol(PortProtocol):
    """Holds back what begins as a text: no frame does. ser2net sends a second client a text that its port is
    in use, and closes the connection."""

    def __init__(self, receiver: Receiver, name: str) -> None:
        super().__init__(receiver, Message.of("connection_closed", port=name))
        self._name = name
        self._text = b""
        self._take = self._take_first
        self.data_received = lambda data: self._take(data)  # type: ignore[method-assign]

    def _take_first(self, data: bytes) -> None:
        received = self._text + data
        if len(received) <= MAX_TEXT_BYTES and _TEXT.fullmatch(received):
            self._text = received
            return
        self._text, self._take = b"", self._receiver.data_received
        self._receiver.data_received(received)

    def connection_lost(self, exc: Exception | None) -> None:
        self._gone = reported_end(self._text, self._name) or self._gone
        super().connection_lost(exc)


def reported_end(received: bytes, port: str) -> Message | None:
    """Why a device server ended the connection, where all that it has sent is a text."""
    if not received or len(received) > MAX_TEXT_BYTES or not _TEXT.fullmatch(received):
        return None
    text = " ".join(received.decode("ascii").split())[:MAX_SHOWN]
    code = "device_server_in_use" if b"in use" in received.lower() else "device_server_said"
    return Message.of(code, port=port, text=text)


class TcpPort:
    def __init__(self, transport: Any, protocol: PortProtocol, name: str) -> None:
        self._transport = transport
        self._protocol = protocol
        self._name = name

    def write(self, data: bytes) -> None:
        if self._transport.is_closing():
            raise WireError(Message.of("port_gone", port=self._name))
        if self._transport.get_write_buffer_size() > 0:
            raise WireError(Message.of("port_full", port=self._name))
        self._transport.write(data)

    def drop_output(self) -> None:
        """The kernel's buffer cannot be emptied; a server that takes nothing is lost by its timeout."""

    def retune(self, baud: int) -> None:
        raise WireError(Message.of("port_own_baud", port=self._name, baud=baud))

    def check(self) -> list[str]:
        if self._transport.is_closing():
            raise WireError(Message.of("port_gone", port=self._name))
        return []

    def close(self) -> None:
        if not self._protocol.closed:
            self._protocol.closed = True
            self._transport.abort()


async def open_socket(url: str, receiver: Receiver) -> OpenPort:
    """Open ``socket://host:port``. Raises PortUnavailable."""
    host, number = address_of(url)
    loop = asyncio.get_running_loop()
    protocol = TcpProtocol(receiver, url)
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            transport, _ = await loop.create_connection(lambda: protocol, host, number)
    except (OSError, UnicodeError) as error:
        raise PortUnavailable(not_connected(url, error)) from error
    detect_loss_soon(transport.get_extra_info("socket"))
    return TcpPort(transport, protocol, url)


def not_connected(url: str, error: Exception) -> Message:
    """Why a connection to a device server was not made, by what that raised."""
    match error:
        case TimeoutError():
            return Message.of("device_server_no_response", port=url)
        case ConnectionRefusedError():
            return Message.of("connection_refused", port=url)
        case UnicodeError():
            return Message.of("port_no_host", port=url)
    return Message.of("port_unreachable", port=url, error=getattr(error, "strerror", None) or str(error))


def detect_loss_soon(connection: socket.socket | None) -> None:
    """Send each request at once, and find out soon that the other end is gone."""
    if connection is None:
        return
    with suppress(OSError):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option in ("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"):
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), 1)
        connection.setsockopt(socket.IPPROTO_TCP, _TCP_USER_TIMEOUT, TCP_LOST_AFTER_MS)


def address_of(url: str) -> tuple[str, int]:
    """Host and port number. Raises PortUnavailable where one is missing."""
    parts = urlsplit(url)
    try:
        number = parts.port
    except ValueError:
        number = None
    if not parts.hostname or number is None:
        raise PortUnavailable(Message.of("port_no_number", port=url, example="socket://192.168.1.20:4001"))
    return parts.hostname, number
