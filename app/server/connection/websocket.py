"""WebSockets as uvicorn speaks them, with bounds, and with a short way out for complete frames."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any, cast

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame
from websockets.protocol import State

from app.server.connection.client_connection import EXTENSION
from app.server.connection.connections import Connection
from app.server.connection.protocol import ConnectionProtocol
from bus.bucket import Bucket
from bus.instants import Monotonic

MAX_MESSAGE_BYTES = 8 * 1024
"""Until its sender is trusted: a page names the units that it shows, a worker itself."""
FRAMES_A_SECOND = 10.0
MAX_FRAMES_AT_ONCE = 60
MAX_UNREAD_BYTES = 64 * 1024
"""Of responses to pings."""
MAX_AFTER_CLOSE_BYTES = 4096
"""Of what a page sent before it saw the server's Close frame, its own Close frame included."""


class WebSocketProtocol(ConnectionProtocol, WebSocketsSansIOProtocol):
    """Handshake, control frames, close and every ``send`` are uvicorn's; only complete frames that are ready
    may bypass it. It writes what it has in the same turn too, so the two cannot mix within a message.
    """

    def __init__(self, *args: Any, connection: Connection, **options: Any) -> None:
        super().__init__(*args, **options)
        self.connection = connection
        self._is_trusted = False
        self._most_bytes, self.conn.max_message_size = self.conn.max_message_size, MAX_MESSAGE_BYTES
        self._after_close_bytes = 0
        self._bucket = Bucket(FRAMES_A_SECOND, MAX_FRAMES_AT_ONCE)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A client that does not read is waited for after one message, not after 64 KiB of them."""
        super().connection_made(transport)
        self.transport.set_write_buffer_limits(high=0)
        self.connection.holder = self

    def connection_lost(self, exc: Exception | None) -> None:
        """In turn: to unwind the app of one takes a millisecond, and a client with some hundred of them may
        drop them all at once."""
        self._unparsed.clear()
        self.disconnected = True  # the app may send before that turn
        self._turns.run(self._sender(), partial(super().connection_lost, exc))

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
        """Of the handshake, which HTTP has parsed in its turn; then of frames."""
        if self.handshake_initiated:
            super().data_received(data)
        else:
            self._parse(data)

    def _parse(self, data: bytes) -> None:
        if self.close_sent and not self._is_closing_in_bounds(len(data)):
            self.transport.abort()
        elif self.handshake_initiated and not self.handshake_complete:
            # A client waits for the response to its handshake (RFC 6455, 4.1).
            self.transport.abort()
        else:
            WebSocketsSansIOProtocol.data_received(self, data)

    def _takes_input(self, size: int) -> bool:  # noqa: ARG002
        return not self.transport.is_closing()

    def _is_ready(self) -> bool:
        return not (self.read_paused or self.transport.is_closing())

    async def receive(self) -> Any:
        """A message for the app. Once it has taken all, the next may be parsed."""
        message = await super().receive()
        if not self.read_paused:
            self._go_on()
        return message

    def handle_text(self, event: Frame) -> None:
        if self._is_allowed(event):
            super().handle_text(event)

    def handle_bytes(self, event: Frame) -> None:
        if self._is_allowed(event):
            super().handle_bytes(event)

    def handle_cont(self, event: Frame) -> None:
        if self._is_allowed(event):
            super().handle_cont(event)

    def handle_pong(self, event: Frame) -> None:
        if self._is_allowed():
            super().handle_pong(event)

    def handle_parser_exception(self) -> None:
        """What cannot be parsed, or may not be sent, ends the connection."""
        assert self.conn.close_sent is not None
        path = self.scope["path"] if self.handshake_initiated else ""
        self._refusals.note(self.connection.address, str(self.conn.close_sent), path)
        self._drop_input()
        super().handle_parser_exception()

    def handle_ping(self) -> None:
        """A frame of the client; its response waits for the client to read."""
        if self.transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            self.transport.abort()
        elif self._is_allowed():
            super().handle_ping()

    async def run_asgi(self) -> None:
        """Run the app, with the fast path in its scope."""
        offered = cast(dict[str, Any], self.scope["extensions"])
        offered[EXTENSION] = self
        try:
            await super().run_asgi()
        finally:
            offered.clear()  # it refers to this protocol, which would live until the next collection

    def write(self, frame: bytes, /) -> bool:
        """As :class:`app.server.connection.client_connection.ClientConnection`."""
        transport = self.transport
        if self.conn.state is not State.OPEN or transport.is_closing() or transport.get_write_buffer_size():
            return False
        transport.write(frame)
        return True

    def trust(self) -> None:
        """Take large messages, and as many as the app reads."""
        self._is_trusted, self.conn.max_message_size = True, self._most_bytes

    def _is_closing_in_bounds(self, size: int) -> bool:
        """Whether ``size`` more bytes may be parsed for the Close frame that ends the connection at once."""
        self._after_close_bytes += size
        return self._after_close_bytes <= MAX_AFTER_CLOSE_BYTES

    def _is_allowed(self, message: Frame | None = None) -> bool:
        """Count a frame. The complete messages of a trusted sender wait for the app to read them."""
        self._pieces += 1
        if self.close_sent or self.transport.is_closing():
            return False
        is_waited_for = self._is_trusted and message is not None and message.fin and not self.frames
        if is_waited_for or self._bucket.take(Monotonic(self.loop.time())):
            return True
        self.conn.fail(CloseCode.POLICY_VIOLATION, "too many messages")
        self.handle_parser_exception()
        return False
