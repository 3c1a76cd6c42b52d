"""How many connections may be open, how long a client may take, how often it may send requests: pure
rules.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from ipaddress import ip_network

import pytest

from app.core.server.connections import (
    HANDSHAKES_A_SECOND,
    HANDSHAKES_TOGETHER_A_SECOND,
    MAX_BODY_S,
    MAX_HANDSHAKES_AT_ONCE,
    MAX_HANDSHAKES_TOGETHER,
    MAX_IN_ALL,
    MAX_OF_ACCOUNT,
    MAX_OF_ADDRESS,
    MAX_STRANGERS,
    MIN_RATE,
    STALL_S,
    WITHIN_S,
    Awaited,
    Backlog,
    ClientConnection,
    Connections,
    Handshakes,
    Pace,
)
from tests.for_each import for_each


class Held(ClientConnection):
    """A connection that notes that it was ended."""

    def __init__(self, address: str, name: str, dropped: list[str], idle: bool) -> None:
        self.address, self.name, self.dropped, self.idle = address, name, dropped, idle

    def give_way(self) -> None:
        self.dropped.append(self.name)

    def is_idle(self) -> bool:
        return self.idle


@dataclass
class World:
    connections: Connections = field(default_factory=lambda: Connections([ip_network("10.0.0.5")]))
    dropped: list[str] = field(default_factory=list)

    def open(self, name: str, address: str = "192.0.2.7", *, idle: bool = True) -> Held:
        connection = Held(address, name, self.dropped, idle)
        self.connections.open(connection)
        return connection

    def open_many(self, count: int, address: str = "192.0.2.7") -> list[Held]:
        return [self.open(f"{address} {number}", address) for number in range(count)]


@pytest.fixture
def world() -> World:
    return World()


def test_the_oldest_of_an_address_gives_way(world: World) -> None:
    world.open_many(MAX_OF_ADDRESS)
    assert world.dropped == []
    world.open("new")
    world.open("newer")
    assert world.dropped == ["192.0.2.7 0", "192.0.2.7 1"]


def test_the_addresses_of_one_subnet_of_ipv6_are_one(world: World) -> None:
    for number in range(MAX_OF_ADDRESS + 1):
        world.open(str(number), f"2001:db8::{number:x}")
    assert world.dropped == ["0"]


def test_among_many_addresses_the_one_with_the_most_gives_way(world: World) -> None:
    world.open("alone", "198.51.100.1")
    addresses = [f"192.0.2.{n}" for n in range(1 + MAX_STRANGERS // (MAX_OF_ADDRESS - 1))]
    for address in addresses:
        world.open_many(MAX_OF_ADDRESS - 1, address)
    assert world.dropped
    assert "alone" not in world.dropped
    assert len(world.dropped) == (MAX_OF_ADDRESS - 1) * len(addresses) + 1 - MAX_STRANGERS


def test_a_connection_being_served_gives_way_last(world: World) -> None:
    world.open("served", idle=False)
    world.open_many(MAX_OF_ADDRESS)
    assert world.dropped == ["192.0.2.7 0"]
    served = [world.open(f"served {n}", "198.51.100.1", idle=False) for n in range(MAX_OF_ADDRESS + 1)]
    assert world.dropped[1:] == ["served 0"]
    assert len(served) == MAX_OF_ADDRESS + 1


def test_an_account_is_no_stranger_wherever_it_comes_from(world: World) -> None:
    for number in range(MAX_OF_ACCOUNT):
        world.connections.identify(world.open(f"ann {number}"), "ann")
    world.open_many(MAX_OF_ADDRESS)
    assert world.dropped == []
    world.connections.identify(world.open("one more"), "ann")
    assert world.dropped == ["192.0.2.7 0", "ann 0"]


def test_an_account_is_counted_once_for_each_connection(world: World) -> None:
    connection = world.open("ann")
    for _ in range(3):
        world.connections.identify(connection, "ann")
    world.connections.identify(connection, "ben")
    assert connection.account == "ann"
    world.connections.close(connection)
    world.connections.close(connection)
    assert world.connections.count(known=True) == world.connections.count(known=False) == 0


def test_who_was_dropped_is_counted_no_more(world: World) -> None:
    oldest, *_ = world.open_many(MAX_OF_ADDRESS + 1)
    world.connections.identify(oldest, "ann")
    world.connections.close(oldest)
    assert world.connections.count(known=True) == 0
    assert world.connections.count(known=False) == MAX_OF_ADDRESS


def test_a_trusted_proxy_has_more_than_a_stranger(world: World) -> None:
    world.open_many(MAX_OF_ADDRESS + 1, "10.0.0.5")
    assert world.dropped == []


def test_there_is_an_end_to_accounts_too(world: World) -> None:
    for number in range(MAX_IN_ALL):
        world.connections.identify(world.open(str(number)), f"account {number // 300}")
    assert world.dropped == []
    world.open("new")
    assert len(world.dropped) == 1


@for_each("awaited", WITHIN_S)
def test_each_awaited_part_has_its_time(awaited: Awaited) -> None:
    pace = Pace(1000.0, awaited)
    assert not pace.is_overdue(1000.0 + WITHIN_S[awaited])
    assert pace.is_overdue(1000.1 + WITHIN_S[awaited])
    pace.expect(Awaited.NOTHING, 1000.0)
    assert not pace.is_overdue(1e9)


def test_a_body_earns_time_by_its_bytes_and_ends_some_time() -> None:
    pace = Pace(0.0, Awaited.BODY, round(30 * MIN_RATE))
    assert not pace.is_overdue(30 + WITHIN_S[Awaited.BODY])
    assert pace.is_overdue(31 + WITHIN_S[Awaited.BODY])
    assert Pace(0.0, Awaited.BODY, 10**9).is_overdue(MAX_BODY_S + 1)
    assert Pace(0.0, Awaited.HEAD, 10**9).is_overdue(WITHIN_S[Awaited.HEAD] + 1)


def test_a_reader_keeps_the_least_rate_or_is_stuck() -> None:
    enough = round(MIN_RATE * STALL_S)
    backlog = Backlog()
    assert not backlog.is_stuck(10 * enough, 0.0)
    assert not backlog.is_stuck(10 * enough, STALL_S - 1)
    assert not backlog.is_stuck(9 * enough, STALL_S)
    assert backlog.is_stuck(8 * enough + 1, 2 * STALL_S)
    assert not backlog.is_stuck(0, 3 * STALL_S)
    assert not backlog.is_stuck(1, 4 * STALL_S)
    assert backlog.is_stuck(1, 5 * STALL_S)


def test_all_pages_of_a_plant_come_back_quickly_and_more_are_delayed() -> None:
    handshakes = Handshakes()
    waits = [handshakes.wait_s("ann", 0.0) for _ in range(MAX_HANDSHAKES_AT_ONCE + 600)]
    assert waits[:MAX_HANDSHAKES_TOGETHER] == [0.0] * MAX_HANDSHAKES_TOGETHER
    assert (
        waits[MAX_HANDSHAKES_AT_ONCE - 1]
        == (MAX_HANDSHAKES_AT_ONCE - MAX_HANDSHAKES_TOGETHER) / HANDSHAKES_TOGETHER_A_SECOND
    )
    assert waits[-1] == 600 / HANDSHAKES_A_SECOND


def test_pages_that_come_one_after_the_other_do_not_wait() -> None:
    handshakes = Handshakes()
    times = (n / HANDSHAKES_TOGETHER_A_SECOND for n in range(MAX_HANDSHAKES_AT_ONCE))
    assert {handshakes.wait_s("ann", at) for at in times} == {0.0}


def test_others_do_not_wait_and_the_delay_ends() -> None:
    handshakes = Handshakes()
    for _ in range(2 * MAX_HANDSHAKES_AT_ONCE):
        handshakes.wait_s("ann", 0.0)
    assert handshakes.wait_s("ben", 0.0) == 0.0
    assert handshakes.wait_s("ann", 0.0) > 1.0
    assert handshakes.wait_s("ann", 1e3) == 0.0
