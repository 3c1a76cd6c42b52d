"""Device servers: raw bytes over TCP, or with serial settings by RFC 2217 (serialx, an extra)."""

from __future__ import annotations

import asyncio
import errno
import os
import re
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from bus.errors import WireError
from bus.line.port import EndedWhileOpening, OpenPort, PortProtocol, PortUnavailable, Receiver
from bus.messages import Message

CONNECT_TIMEOUT_S = 3.0
TCP_LOST_AFTER_MS = 800
"""The milliseconds that bytes may stay unacknowledged before the device server counts as gone."""
MAX_TEXT_BYTES = 400
MAX_SHOWN = 100
_TEXT = re.compile(rb"[\x20-\x7e\r\n\t]+")
_TCP_USER_TIMEOUT = getattr(socket, "TCP_USER_TIMEOUT", 18)


class TcpProtocol(PortProtocol):
    """A protocol that holds back received text, because no frame begins as one. ser2net sends a second client
    a text that its port is in use, and closes the connection."""

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
    """Return why a device server ended the connection, or None if it has sent anything other than a text."""
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

    def listen(self, *, now: bool) -> None:
        """Do nothing: TCP delivers complete segments."""

    def drop_output(self) -> None:
        """Do nothing: the kernel's buffer cannot be emptied. A server that takes nothing is lost by its
        timeout."""

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
    """Open ``socket://host:port``. Raise PortUnavailable if that fails."""
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
    """Return why a connection to a device server failed, by the exception that was raised."""
    match error:
        case TimeoutError():
            return Message.of("device_server_no_response", port=url)
        case ConnectionRefusedError():
            return Message.of("connection_refused", port=url)
        case UnicodeError():
            return Message.of("port_no_host", port=url)
    return Message.of("port_unreachable", port=url, error=getattr(error, "strerror", None) or str(error))


def detect_loss_soon(connection: socket.socket | None) -> None:
    """Send each request at once, and detect within a second that the other end is gone."""
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
    """Return host and port number of ``url``. Raise PortUnavailable if one is missing."""
    parts = urlsplit(url)
    try:
        number = parts.port
    except ValueError:
        number = None
    if not parts.hostname or number is None:
        raise PortUnavailable(Message.of("port_no_number", port=url, example="socket://192.168.1.20:4001"))
    return parts.hostname, number


MAX_NOTED_BYTES = 4096
"""The number of a server's first bytes that are kept for its error text."""
_OPTIONS = re.compile(rb"\xff(?:\xfa.*?\xff\xf0|[\xfb-\xfe].)", re.DOTALL)
"""A Telnet option (RFC 855): a subnegotiation, or a request with its option."""


async def open_rfc2217(url: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open ``rfc2217://host:port`` at ``baud``. Raise PortUnavailable if that fails."""
    try:
        import serialx
    except ImportError as error:
        raise PortUnavailable(Message.of("rfc2217_not_installed", port=url)) from error
    address_of(url)
    protocol = PortProtocol(receiver, Message.of("connection_closed", port=url))
    opening = _UnconfirmedConnection()
    kind = _rfc2217_transport(opening)
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            transport, _ = await serialx.create_serial_connection(
                asyncio.get_running_loop(), lambda: protocol, url, baudrate=baud, transport_cls=kind
            )
            await protocol.made
    except TimeoutError as error:
        no_response = Message.of("rfc2217_no_response", port=url)
        raise PortUnavailable(opening.reported_end(url) or no_response) from error
    except UnicodeError as error:
        raise PortUnavailable(Message.of("port_no_host", port=url)) from error
    except (OSError, ValueError) as error:
        fault = EndedWhileOpening if opening.is_accepted else PortUnavailable
        not_opened = Message.of("port_not_opened_error", port=url, error=str(error))
        raise fault(opening.reported_end(url) or not_opened) from error
    return TcpPort(transport, protocol, url)


@dataclass(slots=True)
class _UnconfirmedConnection:
    """The bytes that a server has sent before its settings are confirmed."""

    is_accepted: bool = False
    received: bytes = b""

    def reported_end(self, url: str) -> Message | None:
        """Return why the server ended the connection, or None. ser2net sends as data, after its options, that
        its port is in use."""
        return reported_end(_OPTIONS.sub(b"", self.received), url)


def _parsed(feed: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """Wrap ``feed`` of the parser so that it raises OSError for bytes that are not RFC 2217."""

    def parse(data: bytes) -> Any:
        try:
            return feed(data)
        except (ValueError, IndexError) as error:
            raise OSError(errno.EPROTO, os.strerror(errno.EPROTO)) from error

    return parse


def _rfc2217_transport(opening: _UnconfirmedConnection) -> Any:
    """Return serialx's transport class, adapted to real servers; ``opening`` notes what they send meanwhile.

    Many never acknowledge the masks of line and modem states (RFC 2217, 3), which mean nothing on RS-422, and
    many send first: bytes before the connection is confirmed would be an error. A command that cannot be
    parsed is the fault of the server: it is raised as OSError, because asyncio prints any other with its
    traceback. serialx has neither a setting nor a public method for all that, so inner ones are overridden,
    and its version is bounded.
    """
    from serialx.platforms.serial_rfc2217 import RFC2217SerialTransport
    from serialx.platforms.serial_rfc2217.types import SetLinestateMaskCmd, SetModemstateMaskCmd

    class Transport(RFC2217SerialTransport):  # type: ignore[misc, unused-ignore]
        _received_first = b""

        def _data_received(self, data: bytes) -> None:
            if len(opening.received) < MAX_NOTED_BYTES:
                opening.received += data
            if self._tcp_transport is None:
                self._received_first += data
            else:
                super()._data_received(data)

        async def _negotiate(self) -> None:
            assert self._tcp_transport is not None
            assert self._serial is not None
            opening.is_accepted = True
            detect_loss_soon(self._tcp_transport.get_extra_info("socket"))
            self._serial._engine.feed = _parsed(self._serial._engine.feed)  # type: ignore[assignment, method-assign, unused-ignore]
            super()._data_received(self._received_first)
            await super()._negotiate()

        async def _send_and_wait(self, command: Any) -> Any:
            if isinstance(command, SetLinestateMaskCmd | SetModemstateMaskCmd):
                self._send_command(command)
                return command
            return await super()._send_and_wait(command)

    return Transport
