"""The port that the host opens (a pseudo-terminal, or a TCP port), and the time of each byte on its wire.

A port can be pulled and plugged again, and nothing here waits. A byte takes ten bits. Every time counts from
the end of the byte before, never from when a process woke up, so lateness does not add up.
"""

from __future__ import annotations

import os
import random
import socket
import termios
import tty
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

WAKE_S = 0.004
"""The seconds that bytes inside a frame may wait for each other, as in an adapter's buffer; its first and
last do not."""


@dataclass(slots=True)
class RequestLine:
    """The pair from the host to the units: bytes handed over early wait for those before them."""

    free_at: float = 0.0

    def carry(self, now: float, count: int, byte_s: float) -> list[float]:
        """Return the times at which ``count`` bytes, written at ``now``, have completely arrived."""
        start = max(now, self.free_at)
        self.free_at = start + count * byte_s
        return [start + place * byte_s for place in range(1, count + 1)]


class Slot(NamedTuple):
    """A byte on the reply pair, complete at ``due``, and whether it begins or ends a transmission."""

    due: float
    value: int
    first: bool
    last: bool


class Wake(NamedTuple):
    """The moment when something is due. ``sharp``: whether the host waits for it."""

    at: float
    sharp: bool


@dataclass(slots=True)
class ReplyLine:
    """The pair from the units to the host. Each sender's bytes stay in order; two at once garble each
    other."""

    _slots: deque[Slot] = field(default_factory=deque)
    _free_at: dict[int, float] = field(default_factory=dict)
    _random: random.Random = field(default_factory=lambda: random.Random(0))

    def transmit(self, talker: int, at: float, data: bytes, byte_s: float) -> float:
        """Put ``data`` on the line from ``at`` on, or once ``talker`` is done; return when its last byte is
        out."""
        if not data:
            return at
        start = max(at, self._free_at.get(talker, 0.0))
        last = len(data) - 1
        slots = [
            Slot(start + (place + 1) * byte_s, value, place == 0, place == last)
            for place, value in enumerate(data)
        ]
        self._free_at[talker] = slots[-1].due
        if not self._slots or self._slots[-1].due <= start:
            self._slots.extend(slots)
        else:
            self._slots = deque(self._collide(slots, byte_s))
        return slots[-1].due

    def due(self, now: float) -> bytes:
        """Return the bytes that have reached the host since the last call."""
        arrived = bytearray()
        while self._slots and self._slots[0].due <= now:
            arrived.append(self._slots.popleft().value)
        return bytes(arrived)

    def wake(self) -> Wake | None:
        """Return when to look again: at the next first or last byte, or after ``WAKE_S`` between them."""
        if not self._slots:
            return None
        latest = self._slots[0].due + WAKE_S
        for slot in self._slots:
            if slot.due > latest:
                break
            if slot.first or slot.last:
                return Wake(slot.due, sharp=slot.last)
        return Wake(latest, sharp=False)

    def clear(self) -> None:
        """Drop the bytes on a cable that was pulled."""
        self._slots.clear()

    def _collide(self, slots: list[Slot], byte_s: float) -> list[Slot]:
        """Merge bytes of two senders less than a byte time apart into one that equals neither."""
        merged: list[Slot] = []
        for slot in sorted((*self._slots, *slots)):
            if merged and slot.due - merged[-1].due < byte_s * 0.999:
                before = merged.pop()
                value = before.value & slot.value & self._random.randrange(256)
                slot = Slot(before.due, value, before.first or slot.first, before.last or slot.last)
            merged.append(slot)
        return merged


READ_BYTES = 4096
_SPEEDS = {getattr(termios, f"B{baud}"): baud for baud in (300, 600, 1200, 2400, 4800, 9600, 19200, 38400)}
_SPEED_CODES = {baud: code for code, baud in _SPEEDS.items()}


class PtyPort:
    """A pseudo-terminal. ``link`` is a stable path, like /dev/serial/by-id, that moves to each new device.

    The slave side stays open here, so that the host may close and open it as it likes. With ``follow_speed``
    the host's termios speed counts; at first it is ``baud``, for hosts that set none.
    """

    def __init__(self, link: Path | None = None, baud: int = 9600, *, follow_speed: bool = True) -> None:
        self._link = link
        self._baud = baud
        self._follow_speed = follow_speed
        self._master = self._slave = -1
        self.device = ""
        """The path of the device, to which the link points."""
        self.plug()

    @property
    def name(self) -> str:
        """The name that the host opens: a device path or a pySerial URL."""
        return str(self._link or self.device)

    def descriptors(self) -> list[int]:
        """Return the file descriptors that become readable when the host has acted."""
        return [self._master] if self._master >= 0 else []

    def read(self) -> bytes:
        """Return the bytes that the host wrote, possibly none."""
        try:
            return os.read(self._master, READ_BYTES)
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Pass bytes to the host; bytes for which it has no room are lost, as in a UART."""
        if self._master >= 0:
            with suppress(OSError):
                os.write(self._master, data)

    def host_baud(self) -> int | None:
        """Return the speed to which the host has set the port, or None if that cannot be seen."""
        if not self._follow_speed or self._master < 0:
            return None
        return _SPEEDS.get(termios.tcgetattr(self._slave)[5], 0) or None

    def unplug(self) -> None:
        """Pull the cable out of the host and remove device and link."""
        if self._master < 0:
            return
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def plug(self) -> None:
        """Put the cable back, under another device name than before: the old name is kept occupied
        meanwhile."""
        if self._master >= 0:
            return
        pairs = [os.openpty(), os.openpty()]
        self._master, self._slave = pairs.pop(1 if os.ttyname(pairs[0][1]) == self.device else 0)
        for descriptor in pairs[0]:
            os.close(descriptor)
        self._prepare()

    def _prepare(self) -> None:
        tty.setraw(self._slave)
        attributes = termios.tcgetattr(self._slave)
        attributes[4] = attributes[5] = _SPEED_CODES[self._baud]
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        if self._link is not None:
            fresh = self._link.with_name(self._link.name + ".new")
            fresh.symlink_to(self.device)
            fresh.replace(self._link)


class TcpLinePort:
    """A TCP port on the loopback that serves one host at a time, as a device server does."""

    def __init__(self, number: int = 0) -> None:
        self._number = number
        self._listener: socket.socket | None = None
        self._host: socket.socket | None = None
        self.plug()

    @property
    def name(self) -> str:
        return f"socket://127.0.0.1:{self._number}"

    def descriptors(self) -> list[int]:
        return [end.fileno() for end in (self._listener, self._host) if end is not None]

    def read(self) -> bytes:
        if self._listener is not None:
            with suppress(BlockingIOError):
                host, _ = self._listener.accept()
                self._take(host)
        if self._host is None:
            return b""
        try:
            data = self._host.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._host.close()
            self._host = None
        return data

    def write(self, data: bytes) -> None:
        if self._host is not None:
            with suppress(OSError):
                self._host.send(data)

    def host_baud(self) -> int | None:
        return None

    def unplug(self) -> None:
        for end in (self._host, self._listener):
            if end is not None:
                end.close()
        self._host = self._listener = None

    def plug(self) -> None:
        if self._listener is not None:
            return
        self._listener = socket.create_server(("127.0.0.1", self._number))
        self._listener.setblocking(False)
        self._number = self._listener.getsockname()[1]

    def _take(self, host: socket.socket) -> None:
        if self._host is not None:
            host.close()
            return
        host.setblocking(False)
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._host = host


Port = PtyPort | TcpLinePort
