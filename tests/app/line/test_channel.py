"""Commands to a bus when the worker does not respond, is gone, or its connection breaks during a message."""

from __future__ import annotations

import asyncio

import pytest

from app.line.feed import channel as channels
from app.line.feed.channel import STUCK_AFTER_LOOKS, Channel
from bus.contract import AppMessage, Command, Progress, Result, SetSpeed
from bus.messages import Message

COMMAND = Command(id="a", deadline=0.0, action=SetSpeed(unit=1, raw=5))


class Connection:
    """Remembers what was sent; ``broken``: the other end is gone."""

    def __init__(self, *, broken: bool = False) -> None:
        self.sent: list[AppMessage] = []
        self.broken = broken

    async def send(self, message: AppMessage) -> None:
        """Raises ConnectionError."""
        if self.broken:
            raise ConnectionError("gone")
        self.sent.append(message)


def verified() -> Result:
    return Result(id="a", at=1.0, outcome="verified")


async def test_without_a_worker_nothing_is_sent() -> None:
    result = await Channel().send(COMMAND)
    assert result.outcome == "bus_closed"


async def test_a_worker_without_a_result_leaves_it_unverified() -> None:
    channel, connection = Channel(patience_s=0.0), Connection()
    await channel.opened(connection, "w")
    result = await channel.send(COMMAND)
    assert (result.id, result.outcome) == ("a", "unverified")
    assert connection.sent == [COMMAND]


@pytest.fixture
def quick_looks(monkeypatch: pytest.MonkeyPatch) -> float:
    """Seconds from look to look."""
    monkeypatch.setattr(channels, "LOOK_S", 0.01)
    return 0.01


@pytest.mark.usefixtures("quick_looks")
async def test_the_wait_for_a_worker_ends_at_the_deadline() -> None:
    channel = Channel()
    await channel.opened(Connection(), "w")
    result = await channel.send(COMMAND)
    assert result.outcome == "unverified"
    assert result.message == Message("worker_no_response")


async def test_a_worker_that_speaks_of_other_things_is_waited_for(quick_looks: float) -> None:
    channel, connection = Channel(), Connection()
    await channel.opened(connection, "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    for _ in range(3 * STUCK_AFTER_LOOKS):
        channel.on_message()
        assert not (await asyncio.wait({sending}, timeout=quick_looks))[0]
    channel.on_update(verified(), connection)
    assert (await sending).outcome == "verified"


async def test_a_worker_that_does_not_come_back_leaves_it_unverified() -> None:
    channel, connection = Channel(reask_s=0.0), Connection(broken=True)
    await channel.opened(connection, "w")
    result = await channel.send(COMMAND)
    assert result.outcome == "unverified"
    assert not channel.connected
    assert (await channel.send(COMMAND)).outcome == "bus_closed"


async def test_a_broken_send_is_repeated_to_the_same_worker() -> None:
    channel, back = Channel(), Connection()
    await channel.opened(Connection(broken=True), "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    await asyncio.sleep(0)
    await channel.opened(back, "w")
    channel.on_update(verified(), back)
    assert (await sending).outcome == "verified"
    assert back.sent == [COMMAND]


async def test_the_first_result_counts_and_old_updates_are_ignored() -> None:
    channel, connection = Channel(), Connection()
    await channel.opened(connection, "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    await asyncio.sleep(0)
    channel.on_update(verified(), connection)
    channel.on_update(Result(id="a", at=2.0, outcome="refused"), connection)
    channel.on_update(Progress(id="a", at=2.0, stage="sent"), connection)
    channel.on_update(Progress(id="nobody", at=2.0, stage="sent"), connection)
    assert (await sending).outcome == "verified"
    channel.on_update(verified(), connection)


async def test_a_result_counts_only_from_the_connection_that_the_command_was_sent_to() -> None:
    channel, connection, other = Channel(patience_s=0.2), Connection(), Connection()
    await channel.opened(connection, "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    await asyncio.sleep(0)
    channel.on_update(verified(), other)
    await channel.opened(other, "w")
    channel.on_update(verified(), connection)
    assert (await sending).outcome == "unverified"
    assert connection.sent == other.sent == [COMMAND]


async def test_a_send_that_fails_late_does_not_close_the_connection_that_came_meanwhile() -> None:
    class Slow(Connection):
        async def send(self, message: AppMessage) -> None:
            self.sent.append(message)
            await channel.opened(newer, "w")
            raise ConnectionError("gone")

    channel, newer = Channel(), Connection()
    await channel.opened(Slow(), "w")
    await channel.reserve()
    assert channel.connected


async def test_an_older_connection_that_ends_later_closes_nothing() -> None:
    channel, older, newer = Channel(), Connection(), Connection()
    await channel.opened(older, "w")
    await channel.opened(newer, "w")
    channel.closed(older)
    assert channel.connected


@pytest.mark.parametrize("units", [[], [2, 1]])
async def test_watched_units_are_sent_once_and_to_the_next_worker(units: list[int]) -> None:
    channel, connection, later = Channel(), Connection(), Connection()
    await channel.opened(connection, "w")
    await channel.watch(units, trace=False)
    await channel.watch(units, trace=False)
    await channel.opened(later, "w2")
    assert len(connection.sent) == len(later.sent) == bool(units)
