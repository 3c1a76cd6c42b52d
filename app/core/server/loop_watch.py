"""When what the event loop delivers can have arrived: the loop, or the machine under it, may have stood
still, and the system accepts connections meanwhile."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress
from typing import Protocol

from bus.instants import Monotonic, MonotonicClock, monotonic_now

TICK_S = 0.05
SOON_S = 0.001
"""Until the first tick after a stall: separates what arrives after it from what arrived during it."""
ORDINARY_TURN_S = 0.15
"""A loop that ticked so short a time ago has not stood still."""


class LoopWatch:
    """Notices stalls of the event loop by ticks. ``since``: when the first client can have come, on the
    monotonic clock ``now``."""

    def __init__(self, since: Monotonic, now: MonotonicClock = monotonic_now) -> None:
        self.now = now
        self._before_last = self._last = since
        self._timer: asyncio.TimerHandle | None = None

    @property
    def polled_after(self) -> Monotonic:
        """A moment after which the loop polled all its sockets before it delivered what it delivers now: that
        was not there yet at this moment.

        The last tick may belong to this turn of the loop, before its poll; the one before it never does.
        """
        return self._before_last

    def earliest(self) -> Monotonic:
        """Return the earliest moment at which what the loop delivers now can have arrived."""
        now = self.now()
        return now if now - self.polled_after <= ORDINARY_TURN_S else self.polled_after

    def start(self) -> None:
        """Tick on the running loop until :meth:`stop`."""
        self._tick()

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _tick(self) -> None:
        now = self.now()
        stood_still = now - self._last > 2 * TICK_S
        self._before_last, self._last = self._last, now
        self._timer = asyncio.get_running_loop().call_later(SOON_S if stood_still else TICK_S, self._tick)


_SENT = struct.Struct("=44xI")
"""tcpi_last_data_sent, u32 in ms, in struct tcp_info (linux/tcp.h, tcp(7))."""


class TcpSocket(Protocol):
    """What asyncio and uvloop give as ``get_extra_info("socket")``."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """Return an option. Raises OSError if the system or the kind of socket does not know it."""


def age_s(connection: TcpSocket | None) -> float | None:
    """Return the age in seconds of a TCP connection on which nothing was sent yet, the time before it was
    accepted included; None if the system does not report it."""
    option = getattr(socket, "TCP_INFO", None)
    if connection is None or option is None:
        return None
    with suppress(OSError):
        info = connection.getsockopt(socket.IPPROTO_TCP, option, _SENT.size)
        if len(info) == _SENT.size:
            sent_ms: int = _SENT.unpack(info)[0]
            return sent_ms / 1000
    return None
