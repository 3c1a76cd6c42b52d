"""What an asyncio transport calls, handed on to whoever hears the port."""

from __future__ import annotations

import asyncio
import os

from bus.line.port.port import Receiver


class PortProtocol(asyncio.Protocol):
    """Between an asyncio transport and a Receiver. ``gone``: what to say when the port is lost."""

    def __init__(self, receiver: Receiver, gone: str) -> None:
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
            self._receiver.connection_lost(f"{self._gone}{_reason(exc)}")


def _reason(exc: Exception | None) -> str:
    number = getattr(exc, "errno", None)
    return f" ({os.strerror(number)})" if number else ""
