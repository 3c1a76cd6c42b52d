"""The two recorders of a campaign, each a process on the machine of the device server.

``wire`` is between port and units, as a tap on the cable: it gives the device server, or the bus worker, a
pseudo-terminal and passes what it reads to the units. ``connections`` sees what arrives for a port of the
device server, by the peer that sent it. Neither changes a byte.
"""

from __future__ import annotations

import json
import os
import select
import socket
import struct
import sys
import termios
import time
import tty
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

READ_BYTES = 4096
BAUD, OSPEED = termios.B9600, 5
ALL_PROTOCOLS = 0x0003
ETHERNET_BYTES, OUTGOING = 14, 4
IPV4, TCP = 0x0800, 6
SYN = 0x02
SO_TIMESTAMPNS = 35
"""Linux; the kernel's time of arrival, however late this process is scheduled (socket(7))."""


def write(log: IO[str], **row: object) -> None:
    """One line, at once: a kill loses nothing that came before. ``at`` is now where it is not given."""
    log.write(json.dumps({"at": time.time(), **row}) + "\n")
    log.flush()


def wire(link: Path, units_port: int, log: IO[str]) -> None:
    """Pass bytes between a pseudo-terminal behind ``link`` and the units, and record them.

    At another speed than that of the units the host sends and receives nothing legible, as on a real port.
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    attributes = termios.tcgetattr(slave)
    attributes[4] = attributes[5] = BAUD
    termios.tcsetattr(slave, termios.TCSANOW, attributes)
    units = socket.create_connection(("127.0.0.1", units_port))
    # What the host has no room for is lost, as in a UART.
    os.set_blocking(master, False)
    units.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.unlink(missing_ok=True)
    link.symlink_to(os.ttyname(slave))
    while True:
        ready, _, _ = select.select([master, units], [], [])
        if master in ready:
            data = os.read(master, READ_BYTES)
            if termios.tcgetattr(slave)[OSPEED] == BAUD:
                write(log, direction="request", data=data.hex())
                units.sendall(data)
        if units in ready:
            data = units.recv(READ_BYTES)
            if not data:
                return
            write(log, direction="response", data=data.hex())
            if termios.tcgetattr(slave)[OSPEED] == BAUD:
                with suppress(BlockingIOError):
                    os.write(master, data)


def connections(port: int, log: IO[str]) -> None:
    """Record each new byte that arrives for ``port``: a segment that is sent again counts once."""
    streams = Streams()
    packets = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
    packets.bind(("eth0", 0))
    packets.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    while True:
        frame, ((_, _, time_of_arrival),), _, (_, _, kind, *_) = packets.recvmsg(65536, 64)
        if kind == OUTGOING or int.from_bytes(frame[12:14], "big") != IPV4:
            continue
        segment = _segment(frame[ETHERNET_BYTES:], port)
        if segment is None:
            continue
        peer, data = streams.take(*segment)
        if data:
            seconds, nanoseconds = struct.unpack("qq", time_of_arrival)
            write(log, at=seconds + nanoseconds / 1e9, peer=peer, data=data.hex())


@dataclass
class Streams:
    """The connections of all peers. A peer that uses its port again has another connection."""

    _expected: dict[str, int] = field(default_factory=dict)
    _used: Counter[str] = field(default_factory=Counter)

    def take(self, peer: str, sequence: int, data: bytes, begins: bool) -> tuple[str, bytes]:
        """The name of the connection, and what is new of a segment of it."""
        if begins:
            # SYN takes a number. A repeated one begins the same connection.
            if self._expected.get(peer) != (sequence + 1) % 2**32:
                self._used[peer] += 1
            self._expected[peer] = (sequence + 1) % 2**32
        known = (self._expected.get(peer, sequence) - sequence) % 2**32
        # What comes after bytes that were not seen is new too: half of all numbers lie ahead.
        new = data[known:] if known < 2**31 else data
        if new:
            self._expected[peer] = (sequence + len(data)) % 2**32
        uses = self._used[peer]
        return (f"{peer}#{uses}" if uses > 1 else peer), new


def _segment(packet: bytes, port: int) -> tuple[str, int, bytes, bool] | None:
    """The peer, the sequence number and the bytes of a TCP segment to ``port``, and whether it begins a
    connection."""
    header = (packet[0] & 0x0F) * 4
    if packet[9] != TCP:
        return None
    source, target, sequence = struct.unpack_from("!HHI", packet, header)
    if target != port:
        return None
    begin, end = header + (packet[header + 12] >> 4) * 4, int.from_bytes(packet[2:4], "big")
    begins = bool(packet[header + 13] & SYN)
    return f"{socket.inet_ntoa(packet[12:16])}:{source}", sequence, packet[begin:end], begins


def main(kind: str, log: str, *words: str) -> None:
    """``wire LOG LINK UNITS_PORT`` or ``connections LOG PORT``."""
    with Path(log).open("a", encoding="utf-8") as output:
        if kind == "wire":
            wire(Path(words[0]), int(words[1]), output)
        else:
            connections(int(words[0]), output)


if __name__ == "__main__":
    main(*sys.argv[1:])
