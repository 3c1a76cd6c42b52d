"""A bare asyncio loop on pyserial-asyncio that only polls: the least that a host in Python can do."""

from __future__ import annotations

import asyncio
import itertools
import sys
from typing import cast

import serial_asyncio

from bus.settings import Dialect, wire_seconds
from bus.wire.commands import ReadStatusRequest, encode_request, longest_reply_bytes
from bus.wire.framing import FrameDecoder, ReceivedFrame

DIALECT = Dialect()
TURNAROUND_S = 0.05


class Poller(asyncio.Protocol):
    """One request out, then wait for a frame or for the time that a good response may take."""

    def __init__(self) -> None:
        self.open = asyncio.Event()
        self.responded = asyncio.Event()
        self._decoder = FrameDecoder(DIALECT)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.WriteTransport, transport)
        self.open.set()

    def data_received(self, data: bytes) -> None:
        if any(isinstance(event, ReceivedFrame) for event in self._decoder.feed(data)):
            self.responded.set()


async def poll(port: str, units: int) -> None:
    _, poller = await serial_asyncio.create_serial_connection(
        asyncio.get_running_loop(), Poller, port, baudrate=9600
    )
    await poller.open.wait()
    requests = [ReadStatusRequest(unit) for unit in range(1, units + 1)]
    for request in itertools.cycle(requests):
        frame = encode_request(request, DIALECT)
        on_the_wire = wire_seconds(len(frame) + longest_reply_bytes(request, DIALECT), 9600)
        poller.responded.clear()
        poller.transport.write(frame)
        try:
            await asyncio.wait_for(poller.responded.wait(), on_the_wire + TURNAROUND_S)
        except TimeoutError:
            continue


if __name__ == "__main__":
    asyncio.run(poll(sys.argv[1], int(sys.argv[2])))
