"""Units written from the printed manual alone, as an independent check of the product.

Nothing is imported from ``bus`` or ``app``. A line of units is behind a pseudo-terminal in a separate thread;
the test operates their switches and reads what reached them.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

DLE, STX, ETX, ACK, NAK = 0x10, 0x02, 0x03, 0x06, 0x15

# Section 4.0: number -> (bytes of its data type, minimum, maximum)
LIST = {
    1: (2, 0, 65535), 2: (4, 0, 99999), 3: (1, 0, 4), 4: (4, 0, 99999), 5: (2, 0, 5000),
    6: (2, 0, 9999), 7: (2, 0, 9999), 8: (1, 0, 2), 9: (4, 0, 99999), 10: (4, 0, 99999),
    11: (4, 0, 99999), 12: (1, 0, 255), 13: (1, 0, 1), 14: (1, 0, 1), 15: (1, 1, 255),
    16: (1, 0, 1), 17: (1, 1, 255), 18: (1, 3, 96), 19: (1, 0, 2), 20: (4, 0, 99999),
    21: (4, 0, 99999), 22: (2, 0, 999), 23: (2, 0, 999), 24: (1, 0, 1), 25: (1, 1, 255),
    26: (1, 0, 1), 27: (1, 0, 3), 28: (1, 0, 3), 29: (4, 0, 99999), 30: (4, 0, 99999),
    31: (4, 0, 79999), 32: (1, 0, 2), 33: (1, 0, 2), 34: (1, 0, 1), 35: (1, 0, 1),
    36: (1, 0, 2), 37: (4, 0, 99999), 38: (4, 0, 99999), 39: (1, 0, 255), 40: (1, 0, 1),
}  # fmt: skip

FACTORY = {
    1: 1750, 2: 20000, 3: 1, 4: 10000, 5: 60, 6: 50, 7: 50, 8: 0, 9: 500, 10: 10, 11: 10, 12: 25,
    13: 0, 14: 0, 15: 10, 16: 1, 17: 0, 18: 96, 19: 1, 20: 0, 21: 4711, 22: 0, 23: 510, 24: 0,
    25: 10, 26: 0, 27: 0, 28: 2, 29: 100, 30: 2000, 31: 20000, 32: 0, 33: 0, 34: 0, 35: 0, 36: 0,
    37: 10000, 38: 5000, 39: 5, 40: 0,
}  # fmt: skip


def frame(body: bytes) -> bytes:
    """DLE STX, the body with every 10h doubled, DLE ETX, two's complement of the sum of the body."""
    stuffed = body.replace(b"\x10", b"\x10\x10")
    return bytes([DLE, STX]) + stuffed + bytes([DLE, ETX, -sum(body) & 0xFF])


def cut_frame(buffer: bytearray) -> bytes | None:
    """Take the next good body out of ``buffer``; None when there is none yet."""
    while True:
        start = buffer.find(bytes([DLE, STX]))
        if start < 0:
            del buffer[:-1]
            return None
        del buffer[:start]
        body, position = bytearray(), 2
        while True:
            if position + 2 >= len(buffer):
                return None
            if buffer[position] != DLE:
                body.append(buffer[position])
                position += 1
            elif buffer[position + 1] == DLE:
                body.append(DLE)
                position += 2
            else:
                break
        complete = buffer[position + 1] == ETX and buffer[position + 2] == -sum(body) & 0xFF
        del buffer[: position + 3 if complete else 1]
        if complete:
            return bytes(body)


@dataclass
class Unit:
    """One drive. ``writes``: (command, unit addressed, data) of everything that was not a read."""

    address: int
    values: dict[int, int] = field(default_factory=lambda: dict(FACTORY))
    commanded: int = 0
    actual: int = 0
    staged: int | None = None
    analog_in: int = 0
    analog_out: int | None = None
    outputs: int = 0
    inputs: int = 0b0000_0010
    remote: bool = True
    at_speed: bool = True
    off: bool = False
    deaf_to: set[int] = field(default_factory=set)
    """Commands that it acknowledges and does not carry out."""
    mute_on: set[int] = field(default_factory=set)
    """Commands that it carries out without a response."""
    highest_parameter: int = 40
    reply_bytes: int = 0
    """Width of an 85h reply; 0: as in the list."""
    writes: list[tuple[int, int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.values[17] = self.address

    def respond(self, body: bytes) -> bytes | None:
        """What it sends for a good frame; None: nothing."""
        target, command, data = body[0], body[1], body[2:]
        if self.off or target not in (0, self.address):
            return None
        if command not in (0x81, 0x85):
            self.writes.append((command, target, data))
        reply = self._carry_out(command, data)
        if target == 0 or command in self.mute_on:
            return None
        return frame(bytes([self.address]) + reply)

    def _carry_out(self, command: int, data: bytes) -> bytes:
        if command == 0x81 and not data:
            return bytes([ACK]) + self._status()
        if command == 0x85 and len(data) == 1:
            return self._read_parameter(data[0])
        if command not in (0x82, 0x83, 0x84, 0x86, 0x87, 0x88):
            return bytes([NAK, 0x89])
        if not self.remote:
            return bytes([NAK, 0x80])
        error = self._write(command, data)
        return bytes([NAK, error]) if error else bytes([ACK])

    def _status(self) -> bytes:
        st2 = self.outputs | self.remote << 6 | self.at_speed << 7
        st1 = self.inputs | (self.values[8] != 0) << 6
        speeds = self.commanded.to_bytes(4, "big") + self.actual.to_bytes(4, "big")
        return speeds + bytes([self.analog_in, st2, st1])

    def _read_parameter(self, number: int) -> bytes:
        if number not in LIST or number > self.highest_parameter:
            return bytes([NAK, 0x82])
        width = self.reply_bytes or LIST[number][0]
        return bytes([ACK]) + self.values[number].to_bytes(width, "big")

    def _write(self, command: int, data: bytes) -> int:
        value = int.from_bytes(data[-4:], "big")
        if command in (0x82, 0x84) and value > self.values[2]:
            return 0x81
        if command == 0x86 and (data[0] not in LIST or data[0] > self.highest_parameter):
            return 0x82
        if command == 0x86 and not LIST[data[0]][1] <= value <= LIST[data[0]][2]:
            return 0x83
        if command == 0x87 and not 1 <= data[0] <= 6:
            return 0x84
        if command == 0x87 and data[1] > 1:
            return 0x85
        if command == 0x88 and self.values[28] != 2:
            return 0x87
        if command == 0x88 and not self.values[29] <= value <= self.values[30]:
            return 0x88
        if command not in self.deaf_to:
            self._act(command, data, value)
        return 0

    def _act(self, command: int, data: bytes, value: int) -> None:
        if command == 0x82:
            self.staged = value
        elif command == 0x84:
            self.commanded = self.actual = value
            self.staged = None
        elif command == 0x83 and self.staged is not None:
            self.commanded = self.actual = self.staged
            self.staged = None
        elif command == 0x86:
            self.values[data[0]] = value
        elif command == 0x87:
            bit = 1 << data[0] - 1
            self.outputs = self.outputs | bit if data[1] else self.outputs & ~bit
        elif command == 0x88:
            self.analog_out = value


class Cable:
    """Units on one pair of wires behind ``path``, which can be pulled and plugged again."""

    def __init__(self, path: Path, units: list[Unit]) -> None:
        self.path = path
        self.units = {unit.address: unit for unit in units}
        self.lock = threading.Lock()
        self._master: int | None = None
        self._slave: int | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def port(self) -> str:
        """What a host opens."""
        return str(self.path)

    def plug(self) -> None:
        """Appear at the path."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))
        self._ending.clear()
        self._thread = threading.Thread(target=self._serve, args=(self._master,), daemon=True)
        self._thread.start()

    def pull(self) -> None:
        """Vanish, like an adapter that is pulled out."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(5)
        self.path.unlink(missing_ok=True)
        for end in (self._master, self._slave):
            if end is not None:
                os.close(end)
        self._master = self._slave = self._thread = None

    def _serve(self, master: int) -> None:
        with suppress(PermissionError):  # a real unit responds in time, whatever the load of this machine
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -10)
        buffer = bytearray()
        while not self._ending.is_set():
            ready, _, _ = select.select([master], [], [], 0.05)
            if not ready:
                continue
            try:
                buffer += os.read(master, 4096)
            except OSError:
                time.sleep(0.01)
                continue
            while (body := cut_frame(buffer)) is not None:
                self._respond(master, body)

    def _respond(self, master: int, body: bytes) -> None:
        with self.lock:
            replies = [unit.respond(body) for unit in self.units.values()]
        for reply in replies:
            if reply is not None:
                time.sleep(0.002)
                os.write(master, reply)


@contextmanager
def plugged(path: Path, units: list[Unit], make: type[Cable] = Cable) -> Iterator[Cable]:
    """A cable with units, pulled at the end."""
    cable = make(path, units)
    cable.plug()
    try:
        yield cable
    finally:
        cable.pull()
