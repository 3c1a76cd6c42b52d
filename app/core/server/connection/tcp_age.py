"""The age of a TCP connection, as the system knows it (Linux: TCP_INFO, tcp(7))."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from typing import Protocol

_SENT = struct.Struct("=44xI")
"""tcpi_last_data_sent, u32 in ms, in struct tcp_info (linux/tcp.h)."""


class TcpSocket(Protocol):
    """What asyncio and uvloop give as ``get_extra_info("socket")``."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """Raises OSError where the system or the kind of socket knows no such option."""


def age_s(connection: TcpSocket | None) -> float | None:
    """Return the age in seconds, the time before it was accepted included, of a connection on which nothing
    was sent yet; None where the system does not report it."""
    option = getattr(socket, "TCP_INFO", None)
    if connection is None or option is None:
        return None
    with suppress(OSError):
        info = connection.getsockopt(socket.IPPROTO_TCP, option, _SENT.size)
        if len(info) == _SENT.size:
            sent_ms: int = _SENT.unpack(info)[0]
            return sent_ms / 1000
    return None
