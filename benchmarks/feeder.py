"""A bus worker without a bus, for the bus ``line``: ``python -m benchmarks.feeder URL TOKEN UNITS RATE``.

Every unit has a new speed ``RATE`` times a second, more than any one wire could bring, evenly spread as a
wire would: one unit in a message, or several where a message each would be more than a hundred a second.
With ``ramping`` behind the rate all units ramp up and down, else they are at speed.
Prints ``ready`` when the app has taken the first pass. For a number on standard input, each of so many
readings that follow changes the e-stop of its unit; then it prints ``flooded``.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

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
    Welcome,
    decode_from_app,
    encode,
)

MAX_MESSAGES_S = 100
OPENED_WITHIN_S = 120.0
"""Sixteen may begin at once, on a clock that is fast."""
TOP = 20_000
SHOWN = {1: 1750, 2: TOP, 3: 1, 8: 0, 12: 50, 22: 0, 23: 100, 28: 1, 29: 0, 30: 0}
"""The parameters that a speed needs to be shown right: span, one decimal, window."""
AT_SPEED_REMOTE, REMOTE, RUN, HEALTHY = 0xC0, 0x40, 0x01, 0x02
RAMP = 300
"""By how much a unit that ramps is faster or slower at its next reading."""


def reading(unit: int, turn: int, inputs: int) -> Reading:
    """Always within the window, never twice the same, so that all is well and all is new."""
    commanded = 10_000 + 10 * unit
    actual = commanded - 30 + (7 * turn + unit) % 61
    return Reading(unit, time.time(), commanded, actual, turn % 256, AT_SPEED_REMOTE, inputs)


def ramping(unit: int, turn: int, inputs: int) -> Reading:
    """Up to the top and down again, each unit at another place of its way."""
    way = (RAMP * turn + 700 * unit) % (2 * TOP)
    commanded, actual = (TOP, way) if way < TOP else (0, 2 * TOP - way)
    return Reading(unit, time.time(), commanded, actual, turn % 256, REMOTE, inputs)


def _state(unit: int) -> UnitState:
    now = time.time()
    parameters = [ParameterValue(unit, number, now, raw) for number, raw in SHOWN.items()]
    return UnitState(unit, UnitLink(unit, now, "online"), reading(unit, 0, RUN | HEALTHY), parameters)


class Inputs(Protocol):
    """What the units have as inputs."""

    def inputs(self, unit: int) -> int:
        """The inputs of the next reading of a unit."""


class EstopFlood:
    """Changes of e-stops, as many as were requested on standard input."""

    def __init__(self) -> None:
        self._left = 0
        self._stopped: set[int] = set()

    def request(self) -> None:
        """A line can be read."""
        self._left += int(sys.stdin.readline() or 0)

    def inputs(self, unit: int) -> int:
        """The inputs of the next reading of a unit."""
        if self._left:
            self._left -= 1
            self._stopped ^= {unit}
            if not self._left:
                print("flooded", flush=True)
        return RUN if unit in self._stopped else RUN | HEALTHY


Measure = Callable[[int, int, int], Reading]
"""Makes the reading of a unit and turn with these inputs."""


async def feed(
    url: str,
    token: str,
    units: int,
    rate: float,
    inputs: Inputs,
    bus: str = "line",
    measure: Measure = reading,
) -> None:
    """Act as a worker of a bus until the server has ended. The server's real worker, which has no port, may
    connect between the hello and the snapshot; then connect a second time, under the same name: the app keeps
    a bus for its worker. Raises RuntimeError where the app refuses it.
    """
    address = url.replace("http", "ws", 1) + "/feed"
    headers = {"Authorization": f"Bearer {token}"}
    name = f"feeder-{time.time()}"
    while True:
        patient = connect(
            address,
            additional_headers=headers,
            compression=None,
            open_timeout=OPENED_WITHIN_S,
            ping_interval=None,
        )
        async with patient as socket:
            with suppress(ConnectionClosed):
                seq = await _introduce(socket, units, name, bus)
                print("ready", flush=True)
                await asyncio.gather(_listen(socket), _speak(socket, (units, rate), inputs, seq, measure))


async def _introduce(socket: ClientConnection, units: int, name: str, bus: str) -> int:
    """Send the first state; the number of the last batch that the app has."""
    now = time.time()
    await socket.send(encode(Hello(CONTRACT_VERSION, bus, name, now, "feeder", "none", now)))
    welcome = decode_from_app(await socket.recv(decode=False))
    if not isinstance(welcome, Welcome) or welcome.refused:
        raise RuntimeError(f"the app refused the feeder: {welcome}")
    states = [_state(unit) for unit in range(1, units + 1)]
    await socket.send(encode(Snapshot(welcome.seq, time.time(), BusLink(now, "open"), states)))
    return welcome.seq


async def _listen(socket: ClientConnection) -> None:
    with suppress(ConnectionClosed):
        async for _ in socket:
            pass


async def _speak(
    socket: ClientConnection, pace: tuple[int, float], inputs: Inputs, last_seq: int, measure: Measure
) -> None:
    units, rate = pace
    at_once = max(1, round(units * rate / MAX_MESSAGES_S))
    pause, due, sent = at_once / (units * rate), time.monotonic(), 0
    for seq in range(last_seq + 1, sys.maxsize):
        due += pause
        await asyncio.sleep(max(0.0, due - time.monotonic()))
        turns = [(n % units + 1, n // units + 1) for n in range(sent, sent + at_once)]
        updates: list[Update] = [measure(unit, turn, inputs.inputs(unit)) for unit, turn in turns]
        sent += at_once
        await socket.send(encode(Batch(seq, time.time(), updates)))


async def _feed_line(url: str, token: str, units: str, rate: str, what: str = "") -> None:
    flood = EstopFlood()
    asyncio.get_running_loop().add_reader(sys.stdin, flood.request)
    measure = ramping if what == "ramping" else reading
    await feed(url, token, int(units), float(rate), flood, measure=measure)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt, OSError):
        asyncio.run(_feed_line(*sys.argv[1:6]))
