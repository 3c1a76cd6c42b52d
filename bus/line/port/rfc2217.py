"""A device server whose serial settings are sent to it (RFC 2217), through serialx, an extra."""

from __future__ import annotations

import asyncio
import errno
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bus.line.port import tcp
from bus.line.port.port import EndedWhileOpening, OpenPort, PortProtocol, PortUnavailable, Receiver
from bus.messages import Message

MAX_NOTED_BYTES = 4096
"""Of what a server sends first."""
_OPTIONS = re.compile(rb"\xff(?:\xfa.*?\xff\xf0|[\xfb-\xfe].)", re.DOTALL)
"""Of Telnet (RFC 855): a negotiation, or a request with its option."""


async def open_rfc2217(url: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open ``rfc2217://host:port`` at ``baud``. Raises PortUnavailable."""
    try:
        import serialx
    except ImportError as error:
        raise PortUnavailable(Message.of("rfc2217_not_installed", port=url)) from error
    tcp.address_of(url)
    protocol = PortProtocol(receiver, Message.of("connection_closed", port=url))
    opening = _UnconfirmedConnection()
    kind = _rfc2217_transport(opening)
    try:
        async with asyncio.timeout(tcp.CONNECT_TIMEOUT_S):
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
    return tcp.TcpPort(transport, protocol, url)


@dataclass(slots=True)
class _UnconfirmedConnection:
    """What a server has sent before its settings are confirmed."""

    is_accepted: bool = False
    received: bytes = b""

    def reported_end(self, url: str) -> Message | None:
        """Why the server ended it; ser2net states that its port is in use as data, after its options."""
        return tcp.reported_end(_OPTIONS.sub(b"", self.received), url)


def _parsed(feed: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """``feed`` of the parser, raising OSError for what is not RFC 2217."""

    def parse(data: bytes) -> Any:
        try:
            return feed(data)
        except (ValueError, IndexError) as error:
            raise OSError(errno.EPROTO, os.strerror(errno.EPROTO)) from error

    return parse


def _rfc2217_transport(opening: _UnconfirmedConnection) -> Any:
    """serialx's transport, which takes servers as they are. ``opening``: what it notes meanwhile.

    Many never acknowledge the masks of line and modem states (RFC 2217, 3), which mean nothing on RS-422, and
    many send first: what they send before the connection is confirmed would be an error. A command that
    cannot be parsed is the fault of the server: it is raised as OSError, because asyncio prints any other
    with its traceback. serialx has neither a setting nor a public method for all that, so inner ones are
    overridden, and its version is bounded.
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
            tcp.detect_loss_soon(self._tcp_transport.get_extra_info("socket"))
            self._serial._engine.feed = _parsed(self._serial._engine.feed)  # type: ignore[assignment, method-assign, unused-ignore]
            super()._data_received(self._received_first)
            await super()._negotiate()

        async def _send_and_wait(self, command: Any) -> Any:
            if isinstance(command, SetLinestateMaskCmd | SetModemstateMaskCmd):
                self._send_command(command)
                return command
            return await super()._send_and_wait(command)

    return Transport
