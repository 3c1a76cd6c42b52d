"""What systemd learns of the server, over a real socket; and when the watchdog is not fed any more."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import cast

import pytest

from app.core.database import Database
from app.core.server.service_manager import MAX_STILL_S, Liveness, ServiceManager
from app.errors import StoreError
from bus.instants import Monotonic
from bus.messages import Message


class Listened:
    """The other end of NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        self._socket.setblocking(False)

    def close(self) -> None:
        self._socket.close()

    def received(self) -> list[str]:
        """Every datagram since the last call."""
        found = []
        while True:
            try:
                found.append(self._socket.recv(1000).decode())
            except BlockingIOError:
                return found


@pytest.fixture
def address(tmp_path: Path) -> str:
    return str(tmp_path / "notify")


@pytest.fixture
def listened(address: str) -> Iterator[Listened]:
    with closing(Listened(address)) as other_end:
        yield other_end


def test_it_sends_each_state_and_no_child_inherits_the_socket(tmp_path: Path) -> None:
    for address in (str(tmp_path / "notify"), f"@lineside-test-{tmp_path.name}"):
        environment = {"NOTIFY_SOCKET": address, "PATH": "/bin"}
        with closing(Listened(address)) as listened:
            manager = ServiceManager(environment)
            assert environment == {"PATH": "/bin"}
            manager.ready("serving at http://a")
            manager.alive()
            manager.stopping()
            assert listened.received() == ["READY=1\nSTATUS=serving at http://a", "WATCHDOG=1", "STOPPING=1"]


def test_a_server_that_restarts_in_its_process_finds_the_manager_again(
    address: str, listened: Listened
) -> None:
    environment = {"NOTIFY_SOCKET": address}
    ServiceManager(environment).restarting(environment)
    assert environment == {"NOTIFY_SOCKET": address}
    ServiceManager(environment).ready("serving at http://a")
    assert [each.split("\n")[0] for each in listened.received()] == ["RELOADING=1", "READY=1"]
    ServiceManager(nowhere := dict[str, str]()).restarting(nowhere)
    assert not nowhere


def test_without_a_manager_or_with_one_that_has_gone_nothing_happens(tmp_path: Path) -> None:
    gone = {"NOTIFY_SOCKET": str(tmp_path / "gone")}
    for environment in (dict[str, str](), gone):
        ServiceManager(environment).alive()


class Store:
    """A database that responds as a test wants."""

    def __init__(self) -> None:
        self.looks = 0
        self.error: Exception | None = None
        self.hangs = asyncio.Event()

    async def write(self, _work: object) -> None:
        self.looks += 1
        if self.error is not None:
            raise self.error
        await self.hangs.wait()


class World:
    """A liveness with a store, workers and time of the test."""

    def __init__(self, address: str, listened: Listened, store: Store) -> None:
        self.listened, self.store = listened, store
        self.now, self.has_workers = Monotonic(0.0), True
        manager = ServiceManager({"NOTIFY_SOCKET": address})
        database = cast(Database, store)
        self.liveness = Liveness(manager, database, lambda: self.has_workers, lambda: self.now)

    async def fed_after(self, seconds: float) -> bool:
        """Whether the watchdog is fed when it is looked at after so long."""
        self.now = Monotonic(self.now + seconds)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        self.liveness.tick()
        return self.listened.received() == ["WATCHDOG=1"]


async def test_a_server_whose_parts_move_on_is_fed(address: str, listened: Listened) -> None:
    world = World(address, listened, Store())
    world.store.hangs.set()
    assert [await world.fed_after(100.0) for _ in range(3)] == [True] * 3
    assert world.store.looks >= 2


async def test_a_store_that_hangs_is_given_a_minute(address: str, listened: Listened) -> None:
    world = World(address, listened, Store())
    assert await world.fed_after(1.0)
    assert await world.fed_after(MAX_STILL_S["store"])
    assert not await world.fed_after(1.0)
    world.store.hangs.set()
    await asyncio.sleep(0)
    assert await world.fed_after(1.0)


async def test_a_store_that_refuses_has_responded(address: str, listened: Listened) -> None:
    world = World(address, listened, Store())
    world.store.error = StoreError(Message("store_closed"))
    assert [await world.fed_after(50.0) for _ in range(4)] == [True] * 4


async def test_buses_without_their_workers_are_a_standstill(address: str, listened: Listened) -> None:
    world = World(address, listened, Store())
    world.has_workers = False
    assert await world.fed_after(MAX_STILL_S["bus workers"])
    assert not await world.fed_after(1.0)
    world.has_workers = True
    assert await world.fed_after(1.0)
