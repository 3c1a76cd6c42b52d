"""Modbus RTU units behind the simulator's paced port, so that Modbus hosts meet the very same wire.

A request has 8 bytes and a response 17: together 25, as with READ SPEED AND STATUS.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from bus.settings import wire_seconds
from bus.simulator.line import WireEventKind, WireRecord
from bus.simulator.ports import ReplyLine, RequestLine, Wake

REGISTERS = 6
_REQUEST_BYTES = 8
_IDLE_S = 0.05


@dataclass
class ModbusLine:
    """Responds to every read of holding registers at once; ``LineServer`` takes it for a
    ``SimulatedLine``.
    """

    baud: int = 9600
    record: WireRecord = field(default_factory=WireRecord)

    def __post_init__(self) -> None:
        self._requests = RequestLine()
        self._replies = ReplyLine()
        self._pending = bytearray()
        self._woken = 0.0

    def receive(self, now: float, data: bytes, _host_baud: int | None = None) -> None:
        self.record.add(now, WireEventKind.CAME, 0, data)
        byte_s = wire_seconds(1, self.baud)
        arrivals = self._requests.carry(now, len(data), byte_s)
        self._pending += data
        while len(self._pending) >= _REQUEST_BYTES:
            request = bytes(self._pending[:_REQUEST_BYTES])
            del self._pending[:_REQUEST_BYTES]
            response = with_crc(bytes((request[0], 3, 2 * REGISTERS)) + bytes(2 * REGISTERS))
            self.record.add(arrivals[-1], WireEventKind.RESPONDED, request[0], response)
            ends = self._replies.transmit(request[0], arrivals[-1], response, byte_s)
            self.record.add(ends, WireEventKind.SENT, 0, response)

    def advance(self, now: float) -> bytes:
        self._woken = now
        return self._replies.due(now)

    def wake(self) -> Wake:
        return self._replies.wake() or Wake(self._woken + _IDLE_S, sharp=False)


def with_crc(data: bytes) -> bytes:
    """Modbus CRC-16 appended, low byte first."""
    crc = 0xFFFF
    for value in data:
        crc ^= value
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return data + crc.to_bytes(2, "little")
