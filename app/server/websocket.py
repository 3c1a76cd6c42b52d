"""WebSockets as uvicorn speaks them, with the short way out of :mod:`app.server.frames`, and with bounds."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, cast

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame
from websockets.http11 import Request
from websockets.protocol import State

from app.server.connections import EXTENSION as CONNECTION
from app.server.connections import Connection
from app.server.counted_protocol import CountedProtocol
from app.server.frames import EXTENSION, OUTLET
from bus.bucket import Bucket
from bus.instants import Monotonic

FEED_PATH = "/feed"
"""Where bus workers send their updates: large messages, and many after a break."""
MOST_MESSAGE_BYTES = 32 * 1024
"""Of any other socket: a page names the units that it shows."""
FRAMES_A_SECOND = 10.0
MOST_FRAMES_AT_ONCE = 60
SLICE_BYTES = 512
"""Parsed at once of a page's socket: 85 empty frames, more than may come at once. A chunk of the network has
room for 40,000, which take half a second."""
MOST_UNREAD_BYTES = 64 * 1024
"""Of responses to pings."""
MOST_AFTER_CLOSE_BYTES = 4096
"""Of what a page sent before it saw the server's Close frame, its own Close frame included."""


class Endings:
    """Ends connections that are lost, one in each iteration of the event loop: to unwind the app of one takes
    a millisecond, and a client with some hundred of them may drop them all at once."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()

    def add(self, end: Callable[[], None]) -> None:
        """Call ``end`` in its turn."""
        self._waiting.append(end)
        if len(self._waiting) == 1:
            asyncio.get_running_loop().call_soon(self._next)

    def _next(self) -> None:
        try:
            self._waiting[0]()
        finally:
            self._waiting.popleft()
            if self._waiting:
                asyncio.get_running_loop().call_soon(self._next)


_endings = Endings()


class WebSocketProtocol(CountedProtocol, WebSocketsSansIOProtocol):
    """Handshake, control frames, close and every ``send`` are uvicorn's; only complete frames that are ready
    may bypass it. It writes what it has in the same turn too, so the two cannot mix within a message.
    """

    def __init__(self, *args: Any, connection: Connection, **options: Any) -> None:
        super().__init__(*args, **options)
        self.connection = connection
        self._is_feed = False
        self._after_close_bytes = 0
        self._bucket = Bucket(FRAMES_A_SECOND, MOST_FRAMES_AT_ONCE)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A client that does not read is waited for after one message, not after 64 KiB of them."""
        super().connection_made(transport)
        self.transport.set_write_buffer_limits(high=0)
        self.connection.holder = self

    def connection_lost(self, exc: Exception | None) -> None:
        _endings.add(partial(super().connection_lost, exc))

    def give_way(self) -> None:
        """Make room at once."""
        self.transport.abort()

    def is_idle(self) -> bool:
        """A page or a worker sends when it has something."""
        return False

    def check(self, now: float) -> None:
        """End the connection of a client that does not read. ``now``: the loop's time."""
        if self._is_at_its_end(now):
            return
        if self._backlog.is_stuck(self.transport.get_write_buffer_size(), now):
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Not more of a page at once than the loop can do without; a worker has shown its token."""
        if self._is_trusted():
            super().data_received(data)
            return
        for start in range(0, len(data), SLICE_BYTES):
            part = data[start : start + SLICE_BYTES]
            if self.transport.is_closing():
                return
            if self.close_sent and not self._is_closing_in_bounds(len(part)):
                self.transport.abort()
                return
            if self.handshake_initiated and not self.handshake_complete:
                # A client waits for the response to its handshake (RFC 6455, 4.1).
                self.transport.abort()
                return
            super().data_received(part)

    def handle_connect(self, event: Request) -> None:
        self._is_feed = event.path.partition("?")[0] == FEED_PATH
        if not self._is_feed:
            self.conn.max_message_size = MOST_MESSAGE_BYTES
        super().handle_connect(event)

    def handle_text(self, event: Frame) -> None:
        if self._is_allowed():
            super().handle_text(event)

    def handle_bytes(self, event: Frame) -> None:
        if self._is_allowed():
            super().handle_bytes(event)

    def handle_cont(self, event: Frame) -> None:
        if self._is_allowed():
            super().handle_cont(event)

    def handle_pong(self, event: Frame) -> None:
        if self._is_allowed():
            super().handle_pong(event)

    def handle_ping(self) -> None:
        """A frame of the client; its response waits for the client to read."""
        if self.transport.get_write_buffer_size() > MOST_UNREAD_BYTES:
            self.transport.abort()
        elif self._is_allowed():
            super().handle_ping()

    async def run_asgi(self) -> None:
        """Run the app, with the fast path in its scope."""
        offered = cast(dict[str, Any], self.scope["extensions"])
        offered |= {EXTENSION: {OUTLET: self}, CONNECTION: self._identify}
        try:
            await super().run_asgi()
        finally:
            offered.clear()  # it refers to this protocol, which would live until the next collection

    def write(self, frame: bytes, /) -> bool:
        """As :class:`app.server.frames.Outlet`."""
        transport = self.transport
        if self.conn.state is not State.OPEN or transport.is_closing() or transport.get_write_buffer_size():
            return False
        transport.write(frame)
        return True

    def _is_trusted(self) -> bool:
        """Whether it is a worker's, which has shown its token by the time it is accepted."""
        return self._is_feed and self.handshake_complete

    def _is_closing_in_bounds(self, size: int) -> bool:
        """Whether ``size`` more bytes may be parsed for the Close frame that ends the connection at once."""
        self._after_close_bytes += size
        return self._after_close_bytes <= MOST_AFTER_CLOSE_BYTES

    def _is_allowed(self) -> bool:
        if self.close_sent or self.transport.is_closing():
            return False
        if self._is_trusted() or self._bucket.take(Monotonic(self.loop.time())):
            return True
        self.conn.fail(CloseCode.POLICY_VIOLATION, "too many messages")
        self.handle_parser_exception()
        return False
