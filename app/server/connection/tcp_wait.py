"""What the kernel knows of how long bytes have waited in a TCP socket (Linux: TCP_INFO, tcp(7))."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

_SENT, _RECEIVED = 44, 52
"""Offsets of tcpi_last_data_sent and tcpi_last_data_recv, u32 in ms, in struct tcp_info (linux/tcp.h)."""
_SIZE = 56
_TIMES = struct.Struct("=I4xI")


class TcpSocket(Protocol):
    """What asyncio and uvloop give as ``get_extra_info("socket")``."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """Raises OSError where the system or the kind of socket knows no such option."""


@dataclass(frozen=True, slots=True)
class TcpWait:
    """Seconds since the kernel received the last data and since it sent some, to its tick of 1-10 ms.

    While it has sent none, the latter is the age of the connection, the time in the backlog included.
    """

    received_s: float
    sent_s: float


def tcp_wait(connection: TcpSocket | None) -> TcpWait | None:
    """None where the system does not report it."""
    option = getattr(socket, "TCP_INFO", None)
    if connection is None or option is None:
        return None
    with suppress(OSError):
        info = connection.getsockopt(socket.IPPROTO_TCP, option, _SIZE)
        if len(info) == _SIZE:
            sent_ms, received_ms = _TIMES.unpack_from(info, _SENT)
            return TcpWait(received_ms / 1000, sent_ms / 1000)
    return None
