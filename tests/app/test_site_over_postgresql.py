"""Two servers over one PostgreSQL: what they share by it."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import pytest

from app.auth.rights import notices
from app.auth.rights.notices import RightsNotice
from app.database import Database, StoreConnection, engine
from app.database.opening import open_database
from app.routing.secret import site_secret
from app.routing.site_servers import SiteServers
from app.sites.board import LineBoard
from app.sites.publisher import CHANNEL, notify_lines
from app.sites.summary import end_notice
from app.sites.summary import notices as notices_of
from bus.instants import UnixTime, unix_now
from tests.app.played_site import PlayedHomes
from tests.app.stage import until
from tests.app.test_line_board import summary
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = needs_postgresql
BUSES = ("wet-end",)


@pytest.fixture
def two() -> Iterator[tuple[Database, Database]]:
    with fresh_database() as store, ExitStack() as opened:
        here, there = (
            opened.enter_context(closing(open_database(store, Path("lineside.db")))) for _ in range(2)
        )
        yield here, there


async def test_two_servers_that_start_at_once_have_one_secret(two: tuple[Database, Database]) -> None:
    secrets = await asyncio.gather(*(each.write(site_secret) for each in two))
    assert len(set(secrets)) == 1
    assert len(secrets[0]) == 32


async def test_the_lines_of_one_are_on_the_board_of_the_other(two: tuple[Database, Database]) -> None:
    here, there = two
    board = LineBoard((), list)
    there.listen(CHANNEL, board.take)
    lines = [summary(f"line-{number}") for number in range(20)]

    # Once a second until the other listens.
    async def publish() -> None:
        while True:
            await notify_lines(here, [*notices_of("app-2", lines)])
            await asyncio.sleep(0.05)

    publishing = asyncio.create_task(publish())
    await until(lambda: len(board.lines()) == len(lines), "the lines")
    publishing.cancel()
    assert not board.lines()[0].is_stale
    await notify_lines(here, [end_notice("app-2")])
    await until(lambda: all(line.is_stale for line in board.lines()), "the end of the server")


async def test_a_withdrawn_right_is_noticed_at_the_other(two: tuple[Database, Database]) -> None:
    here, there = two
    noticed = list[str]()
    there.listen(notices.CHANNEL, noticed.append)

    def change(connection: StoreConnection) -> None:
        notices.announce(connection, RightsNotice("changed", "plc (token)"))

    async def announce() -> None:
        while True:
            await here.write(change)
            await asyncio.sleep(0.05)

    announcing = asyncio.create_task(announce())
    await until(lambda: "changed plc (token)" in noticed, "the notice")
    announcing.cancel()


async def test_both_have_the_clock_of_the_store(two: tuple[Database, Database]) -> None:
    servers = [SiteServers(PlayedHomes(), BUSES) for _ in two]
    comparing = [
        asyncio.create_task(each.compare_clocks(partial(database.read, engine.clock)))
        for each, database in zip(servers, two, strict=True)
    ]
    await until(lambda: all(each.is_clock_known for each in servers), "both clocks")
    now = servers[0].monotonic()
    seen = servers[1].clock.from_store(servers[0].clock.to_store(now))
    assert seen <= now
    for task in comparing:
        task.cancel()


async def test_a_clock_that_is_an_hour_ahead_is_stated_and_counted_in_no_command(
    two: tuple[Database, Database],
) -> None:
    ahead = [0.0, 3600.0]
    servers = [
        SiteServers(PlayedHomes(), BUSES, wall_clock=lambda by=by: UnixTime(unix_now() + by)) for by in ahead
    ]
    comparing = [
        asyncio.create_task(each.compare_clocks(partial(database.read, engine.clock)))
        for each, database in zip(servers, two, strict=True)
    ]
    await until(lambda: all(each.is_clock_known for each in servers), "both clocks")
    await until(lambda: servers[1].clock_notice, "the notice")
    assert servers[0].clock_notice is None
    assert re.search(r"differ by 3(599|600|601) s", str(servers[1].clock_notice))
    now = servers[0].monotonic()
    assert abs(servers[1].clock.from_store(servers[0].clock.to_store(now)) - now) < 60
    for task in comparing:
        task.cancel()
