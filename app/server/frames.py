"""The fast path out of a WebSocket: one frame made once, written to many sockets unchanged.

A server's frames carry no mask (RFC 6455, 5.1) and nothing here is compressed, so a message to many clients
is the same bytes for each. The server puts an :class:`Outlet` into the scope as an ASGI extension; where it
does not, everything goes by ``send``, which is slower and has the same effect.
"""

from __future__ import annotations

import struct
from typing import Protocol, cast

from starlette.types import Scope

EXTENSION = "lineside.frames"
OUTLET = "outlet"
_TEXT = 0x81
"""The last fragment of a text message, and its first (RFC 6455, 5.2)."""


class Outlet(Protocol):
    """One WebSocket, beside its ``send``. Both may be used, one after the other."""

    def write(self, frame: bytes, /) -> bool:
        """Write a complete frame in this turn of the loop, if the socket is open and everything before has
        left; otherwise do nothing and return False. Raises nothing.
        """


class NoOutlet:
    """Where the server offers none: never now."""

    def write(self, _frame: bytes, /) -> bool:
        """Always False."""
        return False


def outlet_of(scope: Scope) -> Outlet:
    """What the server put into the scope of a WebSocket."""
    offered = scope.get("extensions", {}).get(EXTENSION)
    return NoOutlet() if offered is None else cast(Outlet, offered[OUTLET])


def text_frame(payload: bytes) -> bytes:
    """``payload``, UTF-8, as one frame that a server sends."""
    size = len(payload)
    if size < 126:
        return struct.pack("!BB", _TEXT, size) + payload
    if size < 2**16:
        return struct.pack("!BBH", _TEXT, 126, size) + payload
    return struct.pack("!BBQ", _TEXT, 127, size) + payload
