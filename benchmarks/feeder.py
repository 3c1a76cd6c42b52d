"""A bus worker without a bus, for the bus ``line``: ``python -m benchmarks.feeder URL TOKEN UNITS RATE``.

Every unit has a new speed ``RATE`` times a second, more than any one wire could bring, evenly spread as a
wire would: one unit in a message, or several where a message each would be more than a hundred a second.
Prints ``ready`` when the app has taken the first round.
"""

from __future__ import annotations

import asyncio
import sys
import time
from contextlib import suppress

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from bus.contract import (
    CONTRACT_VERSION,
    Batch,
    BusLink,
    Hello,
    ParameterValue,
    Reading,
    Snapshot,
    UnitLink,
    UnitState,
    Update,
    encode,
)

MOST_MESSAGES_S = 100
TOP = 20_000
SHOWN = {1: 1750, 2: TOP, 3: 1, 8: 0, 12: 50, 22: 0, 23: 100, 28: 1, 29: 0, 30: 0}
"""The parameters that a speed needs to be shown right: span, one decimal, window."""
AT_SPEED_REMOTE, RUN_HEALTHY = 0xC0, 0x03


def reading(unit: int, turn: int) -> Reading:
    """Always within the window, never twice the same, so that all is well and all is new."""
    commanded = 10_000 + 10 * unit
    actual = commanded - 30 + (7 * turn + unit) % 61
    return Reading(unit, time.time(), commanded, actual, turn % 256, AT_SPEED_REMOTE, RUN_HEALTHY)


def _state(unit: int) -> UnitState:
    now = time.time()
    parameters = [ParameterValue(unit, number, now, raw) for number, raw in SHOWN.items()]
    return UnitState(unit, UnitLink(unit, now, "online"), reading(unit, 0), parameters)


async def feed(url: str, token: str, units: int, rate: float) -> None:
    """Act as a worker until the server has ended. The server's real worker, which has no port, may connect
    between the hello and the snapshot; then connect a second time.
    """
    address = url.replace("http", "ws", 1) + "/feed"
    headers = {"Authorization": f"Bearer {token}"}
    while True:
        async with connect(address, additional_headers=headers, compression=None) as socket:
            with suppress(ConnectionClosed):
                await _introduce(socket, units)
                print("ready", flush=True)
                await asyncio.gather(_listen(socket), _speak(socket, units, rate))


async def _introduce(socket: ClientConnection, units: int) -> None:
    now = time.time()
    states = [_state(unit) for unit in range(1, units + 1)]
    snapshot = encode(Snapshot(0, now, BusLink(now, "open"), states))
    await socket.send(encode(Hello(CONTRACT_VERSION, "line", f"feeder-{now}", now, "feeder", "none", now)))
    await socket.recv()
    await socket.send(snapshot)


async def _listen(socket: ClientConnection) -> None:
    with suppress(ConnectionClosed):
        async for _ in socket:
            pass


async def _speak(socket: ClientConnection, units: int, rate: float) -> None:
    at_once = max(1, round(units * rate / MOST_MESSAGES_S))
    pause, due, sent = at_once / (units * rate), time.monotonic(), 0
    for seq in range(1, sys.maxsize):
        due += pause
        await asyncio.sleep(max(0.0, due - time.monotonic()))
        updates: list[Update] = [reading(n % units + 1, n // units + 1) for n in range(sent, sent + at_once)]
        sent += at_once
        await socket.send(encode(Batch(seq, time.time(), updates)))


if __name__ == "__main__":
    with suppress(KeyboardInterrupt, OSError):
        asyncio.run(feed(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])))
