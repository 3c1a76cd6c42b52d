"""Leases in PostgreSQL: what one server does, or leaves undone, keeps no other from its own."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, closing

import pytest

from app.database import Database, StoreConnection, engine
from app.errors import StoreError, StoreUnavailableError
from app.home.lease import UNSEEN, Claimant, HomeRow
from app.home.store import LOCK, Beat, HomeStore, read_homes
from bus.instants import Monotonic, monotonic_now
from tests.postgresql import fresh_database, needs_postgresql

PostgresqlDatabase = pytest.importorskip("app.database.postgresql.database").PostgresqlDatabase
pytestmark = needs_postgresql
BUS, OTHER, PATIENCE_S = "dry-end", "wet-end", 20.0


@pytest.fixture
def databases() -> Iterator[tuple[Database, Database]]:
    """The same store, as two servers have it."""
    with fresh_database() as store, ExitStack() as stack:
        one, other = (stack.enter_context(closing(PostgresqlDatabase(store, "main"))) for _ in range(2))
        yield one, other


async def taken(database: Database, server: str, bus: str) -> HomeStore:
    """The leases of a server that has just taken ``bus``."""
    store = HomeStore(database, monotonic_now)
    first = UNSEEN.again(None, monotonic_now())
    row = await store.take(
        first, Claimant(server, server), bus, url="", epoch_above=0, reason="", within_s=PATIENCE_S
    )
    assert isinstance(row, HomeRow)
    return store


async def test_a_server_that_stands_still_in_a_transaction_keeps_no_other_from_renewing(
    databases: tuple[Database, Database],
) -> None:
    one, other = databases
    renewing, _ = await taken(one, "a", BUS), await taken(other, "b", OTHER)
    is_locked, goes_on = threading.Event(), threading.Event()

    def stand_still(connection: StoreConnection) -> None:
        engine.lock(connection, LOCK)
        connection.execute("UPDATE home SET bus = bus WHERE bus = ?", (OTHER,))
        is_locked.set()
        goes_on.wait(PATIENCE_S)

    standing = asyncio.create_task(other.write(stand_still))
    try:
        await asyncio.to_thread(is_locked.wait, PATIENCE_S)
        beat = await renewing.beat("a", "a", "", {BUS: 1})
        assert not standing.done()
    finally:
        goes_on.set()
        await standing
    assert beat.rows[BUS].renewals == 1
    assert beat.rows[OTHER].renewals == 0


async def test_what_it_has_locked_is_free_before_a_lease_runs_out(
    databases: tuple[Database, Database],
) -> None:
    one, other = databases
    await taken(one, "a", BUS)
    is_locked, goes_on = threading.Event(), threading.Event()

    def stand_still(connection: StoreConnection) -> None:
        engine.lock(connection, LOCK)
        is_locked.set()
        goes_on.wait(PATIENCE_S)
        connection.execute("DELETE FROM home")

    standing = asyncio.create_task(other.write_briefly(stand_still))
    try:
        await asyncio.to_thread(is_locked.wait, PATIENCE_S)
        async with asyncio.timeout(PATIENCE_S):
            while True:
                try:
                    await taken(one, "a", OTHER)
                    break
                except StoreError:
                    assert not standing.done()
    finally:
        goes_on.set()
    with pytest.raises(StoreUnavailableError):
        await standing
    rows = (await other.write_briefly(read_homes)).rows
    assert set(rows) == {BUS, OTHER}, "it has another connection, and nothing of the former came in"


async def test_a_renewal_and_another_server_that_takes_the_bus_do_not_both_succeed(
    databases: tuple[Database, Database],
) -> None:
    """The holder renews between the look and the write of the one that takes it."""
    one, other = databases
    holding = await taken(one, "a", BUS)
    await one.write(lambda c: c.execute("UPDATE home SET until = until - 100"))
    lapsed = (await one.read(read_homes)).rows[BUS]
    loop = asyncio.get_running_loop()
    renewals: list[Future[Beat]] = []

    def waits() -> bool:
        return (
            other.read_now(lambda c: c.execute("SELECT 1 FROM pg_locks WHERE NOT granted").fetchone())
            is not None
        )

    def in_the_middle() -> Monotonic:
        """What the transaction that takes the bus calls once it has read the row."""
        if not renewals:
            renewals.append(asyncio.run_coroutine_threadsafe(holding.beat("a", "a", "", {BUS: 1}), loop))
        while not (renewals[0].done() or waits()):
            time.sleep(0.01)
        return monotonic_now() + 100.0

    taking, seen = HomeStore(other, in_the_middle), UNSEEN.again(lapsed, Monotonic(0.0), 1)
    found = await taking.take(
        seen, Claimant("b", "b"), BUS, url="", epoch_above=0, reason="", within_s=PATIENCE_S
    )
    assert isinstance(found, HomeRow)
    assert (await asyncio.wrap_future(renewals[0])).rows[BUS] == found


async def test_a_bus_that_is_taken_too_late_is_released(databases: tuple[Database, Database]) -> None:
    one, _ = databases
    goes_on = threading.Event()

    def slow() -> Monotonic:
        goes_on.wait(PATIENCE_S)
        return monotonic_now()

    first = UNSEEN.again(None, monotonic_now())
    claimant = Claimant("a", "a")
    with pytest.raises(TimeoutError):
        await HomeStore(one, slow).take(first, claimant, BUS, url="", epoch_above=0, reason="", within_s=0.01)
    goes_on.set()
    async with asyncio.timeout(PATIENCE_S):
        while True:
            row = (await one.read(read_homes)).rows.get(BUS)
            if row is not None and row.is_released:
                break
            await asyncio.sleep(0.01)
    assert row.epoch == 1
