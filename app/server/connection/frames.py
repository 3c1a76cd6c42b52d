"""The fast path out of a WebSocket: one frame made once, written to many sockets unchanged.

A server's frames carry no mask (RFC 6455, 5.1) and nothing here is compressed, so a message to many clients
is the same bytes for each, which :mod:`app.server.connection.client_connection` writes.
"""

from __future__ import annotations

import struct

_TEXT = 0x81
"""The last fragment of a text message, and its first (RFC 6455, 5.2)."""


def text_frame(payload: bytes) -> bytes:
    """``payload``, UTF-8, as one frame that a server sends."""
    size = len(payload)
    if size < 126:
        return struct.pack("!BB", _TEXT, size) + payload
    if size < 2**16:
        return struct.pack("!BBH", _TEXT, 126, size) + payload
    return struct.pack("!BBQ", _TEXT, 127, size) + payload
