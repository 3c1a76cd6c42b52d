"""Uvicorn's WebSocket with the short way out of :mod:`app.web.frames`."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

from app.web.frames import EXTENSION, OUTLET


class FramesProtocol(WebSocketsSansIOProtocol):
    """Handshake, control frames, close and every ``send`` are uvicorn's; only whole frames that are ready
    may pass it by. It writes what it has in the same turn too, so the two cannot mix within a message."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Whoever does not read is waited for after one message, not after 64 KiB of them."""
        super().connection_made(transport)
        self.transport.set_write_buffer_limits(high=0)

    async def run_asgi(self) -> None:
        """The app, told of the short way."""
        self.scope["extensions"][EXTENSION] = {OUTLET: self}
        await super().run_asgi()

    def write(self, frame: bytes, /) -> bool:
        """As :class:`app.web.frames.Outlet`."""
        transport = self.transport
        if self.conn.state is not State.OPEN or transport.is_closing() or transport.get_write_buffer_size():
            return False
        transport.write(frame)
        return True
