"""Two units behind the app without a worker, a socket or a port: they respond to every command at once."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass, field

import msgspec

from app.feature import Services
from app.line.feed.channel import Channel
from app.line.live.bus_live import LiveState
from bus.contract import (
    AppMessage,
    BusLink,
    Cancel,
    Command,
    Outcome,
    ParameterValue,
    Reading,
    ReadParameters,
    Result,
    UnitLink,
    WriteParameter,
)
from tests.app.played_commands import HEALTHY, REMOTE, factory

BUS = "dry-end"
Before = Callable[[int], Awaitable[None]]


async def _nothing(_: int) -> None:
    """Nothing happens before."""


@dataclass
class PlayedLine:
    """``memory``: unit → number → raw. ``before_read`` is awaited with the unit of each read,
    ``before_write`` with the count of writes before each one; commands that are neither reads nor writes of
    parameters are ``held`` until the test ends them."""

    channel: Channel
    live: LiveState
    memory: dict[int, dict[int, int]] = field(default_factory=lambda: {1: factory(), 2: factory()})
    before_read: Before = _nothing
    before_write: Before = _nothing
    written: list[tuple[int, int, int]] = field(default_factory=list)
    held: list[Command] = field(default_factory=list)
    cancelled: list[str] = field(default_factory=list)
    _responses: set[asyncio.Task[None]] = field(default_factory=set)

    async def send(self, message: AppMessage) -> None:
        """As the connection of a worker."""
        if isinstance(message, Command):
            task = asyncio.create_task(self._respond(message))
            self._responses.add(task)
            task.add_done_callback(self._responses.discard)
        elif isinstance(message, Cancel):
            self.cancelled.append(message.id)

    def keep_responding(self) -> None:
        """Each unit goes on as it was read last: a test that a busy machine holds up loses none."""

        async def respond() -> None:
            while True:
                await asyncio.sleep(0.5)
                for unit in self.live.buses[BUS].units.values():
                    if unit.reading is not None:
                        self.live.buses[BUS].apply([msgspec.structs.replace(unit.reading, at=time.time())])

        self._responses.add(asyncio.create_task(respond()))

    def end(self, outcome: Outcome) -> None:
        """Give the command that was held last its result."""
        self.channel.on_update(Result(self.held[-1].id, time.time(), outcome), self)

    async def _respond(self, command: Command) -> None:
        match command.action:
            case ReadParameters(unit=unit, numbers=numbers):
                values = [_value(unit, number, self.memory[unit][number]) for number in numbers]
                await self.before_read(unit)
                self.live.buses[BUS].apply(values)
                self.channel.on_update(Result(command.id, time.time(), "verified", values=values), self)
            case WriteParameter(unit=unit, number=number, raw=raw):
                await self.before_write(len(self.written))
                self.memory[unit][number] = raw
                self.written.append((unit, number, raw))
                self.live.buses[BUS].apply([_value(unit, number, raw)])
                self.channel.on_update(Result(command.id, time.time(), "verified", read_back=raw), self)
            case _:
                self.held.append(command)


def _value(unit: int, number: int, raw: int) -> ParameterValue:
    return ParameterValue(unit=unit, number=number, at=time.time(), raw=raw, frame=b"\x10")


async def played_line(services: Services, stopped: Collection[int] = ()) -> PlayedLine:
    """Both units of ``settings_in`` are online, in REMOTE, and stand still. ``stopped``: by an e-stop."""
    line = PlayedLine(services.buses[BUS][Channel], services[LiveState])
    now = time.time()
    services[LiveState].buses[BUS].worker_lost = None
    services[LiveState].buses[BUS].apply([BusLink(at=now, link="open")])
    for unit in line.memory:
        services[LiveState].buses[BUS].apply([UnitLink(unit=unit, at=now, link="online")])
        services[LiveState].buses[BUS].apply(
            [Reading(unit, now, 0, 0, 0, REMOTE, 0 if unit in stopped else HEALTHY)]
        )
    await line.channel.opened(line, "w1")
    line.keep_responding()
    return line


def estop(services: Services, *, active: bool, unit: int = 1) -> None:
    """Apply a reading in which the emergency stop of a unit is active, or is not."""
    reading = Reading(unit, time.time(), 0, 0, 0, REMOTE, 0 if active else HEALTHY)
    services[LiveState].buses[BUS].apply([reading])
