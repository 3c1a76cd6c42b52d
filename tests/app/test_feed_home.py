"""A worker and the home of its bus: who is taken in, who is sent where, and what ends with the home."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from msgspec.structs import replace

from bus.contract import Command, LeaseLeft, LeaseRequest, SetSpeed, Welcome
from bus.instants import unix_now
from tests.app.stage import Stage, hello, until


@dataclass
class PlayedHome:
    """As `app.home.homes.BusHome`."""

    is_here: bool = True
    epoch: int = 5
    left_s: float = 3.0
    url: str = "http://b:8000"
    can_outnumber: bool = True

    async def outnumber(self, epoch: int) -> bool:
        if self.can_outnumber:
            self.epoch = epoch + 1
        return self.can_outnumber


def at(stage: Stage, home: PlayedHome) -> PlayedHome:
    stage.feed.home = home  # type: ignore[assignment]
    stage.channel._home = home
    return home


async def welcomed(stage: Stage, epoch: int = 0) -> Welcome:
    worker = await stage.connect()
    await worker.send(replace(hello(), epoch=epoch))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    return welcome


async def test_a_worker_is_sent_to_the_home_of_its_bus(stage: Stage) -> None:
    at(stage, PlayedHome(is_here=False))
    welcome = await welcomed(stage)
    assert welcome.refused == "this server is not the home of the bus now"
    assert welcome.home == "http://b:8000"
    assert not stage.live.buses["dry-end"].worker_connected


async def test_the_home_gives_its_epoch_with_the_welcome_and_each_command(stage: Stage) -> None:
    at(stage, PlayedHome())
    worker = await stage.worker()
    sending = asyncio.create_task(stage.channel.send(Command("a", unix_now() + 2, SetSpeed(1, 5))))
    command = await worker.receive(Command)
    assert isinstance(command, Command)
    assert command.epoch == 5
    sending.cancel()
    await asyncio.gather(sending, return_exceptions=True)


async def test_a_server_that_is_not_the_home_sends_no_command(stage: Stage) -> None:
    home = at(stage, PlayedHome())
    worker = await stage.worker()
    home.is_here = False
    result = await stage.channel.send(Command("a", unix_now() + 2, SetSpeed(1, 5)))
    assert (result.outcome, str(result.message)) == (
        "not_sent",
        "this server is not the home of the bus now; nothing was sent",
    )
    assert worker.commands == []


async def test_a_worker_that_has_seen_a_higher_epoch_is_outnumbered_or_refused(stage: Stage) -> None:
    home = at(stage, PlayedHome())
    assert (await welcomed(stage, epoch=40)).epoch == 41
    home.can_outnumber = False
    assert "has seen epoch 90 of the bus" in (await welcomed(stage, epoch=90)).refused


async def test_a_lease_is_confirmed_for_the_time_that_is_left(stage: Stage) -> None:
    home = at(stage, PlayedHome(left_s=2.5))
    worker = await stage.worker()
    await worker.send(LeaseRequest(requested_at=77.0))
    assert await worker.receive(LeaseLeft) == LeaseLeft(77.0, 2.5)
    home.left_s = -1.0
    await worker.send(LeaseRequest(requested_at=78.0))
    await until(lambda: LeaseLeft(78.0, 0.0) in worker.received, "the end of the lease")


async def test_an_open_command_is_unverified_and_the_worker_leaves_when_the_home_is_lost(
    stage: Stage,
) -> None:
    at(stage, PlayedHome())
    async with stage.feed.at_home():
        worker = await stage.worker()
        sending = asyncio.create_task(stage.channel.send(Command("a", unix_now() + 20, SetSpeed(1, 5))))
        await worker.receive(Command)
    result = await sending
    assert result.outcome == "unverified"
    assert "moved to another server" in str(result.message)
    await worker.gone()
    assert not stage.live.buses["dry-end"].worker_connected
