"""Forwards the callbacks of an asyncio transport to the receiver of the port."""

from __future__ import annotations

import asyncio
import os

from bus.line.port.port import Receiver
from bus.messages import Message


class PortProtocol(asyncio.Protocol):
    """Between an asyncio transport and a Receiver. ``gone``: what is reported when the port is lost."""

    def __init__(self, receiver: Receiver, gone: Message) -> None:
        self.made: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.closed = False
        self._gone = gone
        self._receiver = receiver
        self.data_received = receiver.data_received  # type: ignore[method-assign]

    def connection_made(self, _transport: asyncio.BaseTransport) -> None:
        if not self.made.done():
            self.made.set_result(None)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.closed:
            self.closed = True
            self._receiver.connection_lost(_with_reason(self._gone, exc))


def _with_reason(gone: Message, error: Exception | None) -> Message:
    number = getattr(error, "errno", None)
    return Message.of("port_lost_error", reason=gone, error=os.strerror(number)) if number else gone
