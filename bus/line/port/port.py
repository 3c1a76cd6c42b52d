"""A port as the rest of the line sees it, whichever kind it is."""

from __future__ import annotations

import asyncio
import os
from typing import Protocol

from bus.errors import WireError
from bus.messages import Message


class PortUnavailable(WireError):
    """The port cannot be opened now; the message has the reason and what to do."""


class EndedWhileOpening(PortUnavailable):
    """The other end took the connection and ended it before the port was open."""


class PartlySent(WireError):
    """The port took some of a request and broke: whether a unit received it is not known."""


class Receiver(Protocol):
    """Called with what comes from the port."""

    def data_received(self, data: bytes) -> None:
        """Bytes came in."""

    def connection_lost(self, cause: Message) -> None:
        """The port is gone, and why. Called once, never after ``close``."""


class OpenPort(Protocol):
    """An open port. It is single-use: once lost or closed it is reopened as a new one."""

    def write(self, data: bytes) -> None:
        """Hand over one request at once. Raises PartlySent where some of it was taken, else WireError."""

    def drop_output(self) -> None:
        """Forget what has not left yet."""

    def retune(self, baud: int) -> None:
        """Go on at ``baud``. Raises WireError where the port cannot."""

    def check(self) -> list[str]:
        """What another program changed of its settings since the last call, which was put back.
        Raises WireError when the port is gone and this was not reported yet."""

    def close(self) -> None:
        """Give it back, at once."""


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
            cause, number = self._gone, getattr(exc, "errno", None)
            if number:
                cause = Message.of("port_lost_error", reason=cause, error=os.strerror(number))
            self._receiver.connection_lost(cause)
