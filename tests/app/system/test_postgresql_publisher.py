"""The plant's database has what the site stores, row by row, whatever happens to either of them."""

from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.web.access import Role
from app.line.alarms.alarm import alarm_key
from app.line.alarms.line_alarms import SiteAlarms
from app.line.history import tables
from app.line.history.recorder import compact
from app.line.history.service import History
from app.line.history.writer import MIGRATIONS
from app.system.postgresql.publisher import Publisher
from bus.contract import UnitLink, Update
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from tests.app.complete_app import House
from tests.app.fake_worker import until
from tests.app.plant_database import (
    SCALES,
    compare_events,
    compare_readings,
    iso,
    keep,
    minutes_ago,
    published,
    publishing,
    reading,
    rows,
)
from tests.postgresql import OwnPostgresql, needs_postgresql
from tests.sizes import sizes

pytestmark = needs_postgresql
MAX_CATCH_UP_S = 3600.0


def polls(start: float, end: float, each: int = 5) -> list[Update]:
    """Readings of both units; some are steady for a while, some bits change."""
    count = round((end - start) * each)
    return [
        reading(
            1 + i % 2,
            start + i / each,
            500 + (i // 40 % 3) * (i % 11),
            inputs=0b11 if i // 300 % 2 else 0b1,
            outputs=0xC0 | i // 100 % 64,
        )
        for i in range(count)
    ]


@pytest.mark.parametrize(("readings", "step"), sizes(("all", 0.0), ("1 s", 1.0), ("10 s", 10.0)))
async def test_the_rows_are_what_the_api_serves(
    tmp_path: Path, database: str, readings: str, step: float
) -> None:
    start = minutes_ago(6)
    async with publishing(tmp_path, database, readings) as house:
        await published(house)
        keep(house, [*SCALES, *polls(start, start + 240)])
    # The end of a server folds its minutes, which are then sent as they are stored.
    async with publishing(tmp_path, database, readings) as house:
        await published(house)
        program = await house.program(Role.VIEWER)
        assert await compare_readings(program, database, start, start + 300, step) > 100
        [(first,)] = rows(database, "SELECT min(id) FROM lineside.event")
        await published(house)
        assert await compare_events(program, database, first) > 0


async def test_a_reading_is_there_before_its_minute_is_over(tmp_path: Path, database: str) -> None:
    async with publishing(tmp_path, database) as house:
        await published(house)
        keep(house, SCALES)

        def is_there() -> bool:
            keep(house, [reading(1, float(unix_now()), 500)])
            return bool(rows(database, "SELECT 1 FROM lineside.reading LIMIT 1"))

        await until(is_there, "a row")


async def test_a_database_that_is_killed_gets_everything_once(tmp_path: Path) -> None:
    start = minutes_ago(8)
    with closing(OwnPostgresql()) as server:
        async with publishing(tmp_path / "site", server.url, "1 s") as house:
            await published(house)
            keep(house, [*SCALES, *polls(start, start + 60)])
            await published(house)
            server.kill()
            keep(house, polls(start + 60, start + 240))
            await house.add("anna", Role.OPERATOR)
            publisher = house.services[Publisher]
            await until(lambda: publisher.status.fault is not None, "a fault")
            assert publisher.status.fault
            assert publisher.status.fault.code in ("publisher_unreachable", "publisher_failed")
            # The line runs on, and everything is served as before.
            program = await house.program(Role.OPERATOR)
            assert (await program.get("/api/v1/line")).status_code == 200
            assert "lineside_publisher_up 0.0" in (await program.get("/metrics")).text
            page = await (await house.signed_in(Role.ADMIN)).get("/system")
            assert "It lacks what was stored in the last" in page.text
        async with publishing(tmp_path / "site", server.url, "1 s") as house:
            publisher = house.services[Publisher]
            await until(lambda: publisher.status.fault is not None, "a fault")
            assert publisher.status.lag_s(unix_now()) > 0
            server.start()
            await published(house)
            program = await house.program(Role.VIEWER)
            assert await compare_readings(program, server.url, start, start + 240, 1.0) > 400
            await published(house)
            [(first,)] = rows(server.url, "SELECT min(id) FROM lineside.event")
            assert await compare_events(program, server.url, first) > 3


async def test_what_was_given_up_meanwhile_arrives_as_minutes(tmp_path: Path, database: str) -> None:
    start = minutes_ago(300) // 3600 * 3600
    async with publishing(tmp_path, database) as house:
        await published(house)
        keep(house, [*SCALES, *polls(start, start + 300, each=2)])
    with closing(Database(tmp_path / "data" / "history.db", MIGRATIONS)) as history:
        while found := history.read_now(lambda c: tables.next_to_compact(c, 1 << 62)):
            history.write_now(lambda c, found=found: compact(c, *found))  # type: ignore[misc]
        # As long ago as the cursor, and given up since.
        history.write_now(lambda c: tables.write_raw_from(c, round((start + 3600) * 1e6)))
        history.write_now(lambda c: c.execute("DELETE FROM raw"))
    with closing(Database(tmp_path / "data" / "lineside.db")) as site:
        site.write_now(
            lambda c: c.execute(
                "UPDATE publisher_cursor SET value = ? WHERE name = 'until'", (round(start * 1e6),)
            )
        )
    async with publishing(tmp_path, database) as house:
        await published(house)
        minutes = (
            "SELECT extract(epoch FROM at)::bigint, count FROM lineside.minute WHERE unit = 1 ORDER BY at"
        )
        assert rows(database, minutes) == [(start + 60 * i, 60) for i in range(5)]


async def test_minutes_add_up_to_the_report(tmp_path: Path, database: str) -> None:
    start = minutes_ago(6)
    async with publishing(tmp_path, database, "10 s") as house:
        await published(house)
        stands = [reading(1, start + 100 + i, 0) for i in range(40)]
        runs = [*polls(start, start + 100, each=2), *stands, *polls(start + 140, start + 240, each=2)]
        keep(house, [*SCALES, *runs])
    async with publishing(tmp_path, database, "10 s") as house:
        await published(house)
        program = await house.program(Role.VIEWER)
        span = {"from": iso(start), "to": iso(start + 240)}
        report = (await program.get("/api/v1/report", params=span)).json()
        for unit in report["units"]:
            [found] = rows(
                database,
                "SELECT sum(known_s), sum(run_s), sum(at_speed_s), round(sum(length)::numeric, 3)"
                " FROM lineside.minute WHERE unit = %s",
                unit["unit"],
            )
            assert found[:3] == pytest.approx([unit[name] for name in ("known_s", "running_s", "at_speed_s")])
            assert (None if found[3] is None else float(found[3])) == unit["length"]


async def test_a_unit_that_is_lost_has_a_row_without_values(tmp_path: Path, database: str) -> None:
    at = minutes_ago(1)
    async with publishing(tmp_path, database) as house:
        await published(house)
        keep(house, [*SCALES, reading(1, at, 500), UnitLink(1, at + 1, "offline", Message("no_response"))])
        await published(house)
    async with publishing(tmp_path, database) as house:
        await published(house)
        query = "SELECT extract(epoch FROM at)::bigint, link, actual FROM lineside.reading ORDER BY at"
        assert rows(database, query) == [(at, "online", 50.0), (at + 1, "offline", None)]


async def test_a_unit_that_is_called_otherwise_has_a_new_row(tmp_path: Path, database: str) -> None:
    for _ in range(2):
        async with publishing(tmp_path, database) as house:
            await published(house)
    async with publishing(tmp_path, database, unwind="Unwinder") as house:
        await published(house)
    query = (
        "SELECT name, valid_from > now() - interval '1 hour' FROM lineside.unit"
        " WHERE unit = 1 ORDER BY valid_from"
    )
    assert rows(database, query) == [("Unwind", False), ("Unwinder", True)]
    assert rows(database, "SELECT name FROM lineside.unit_now WHERE unit = 1") == [("Unwinder",)]


async def test_an_alarm_has_when_it_came_cleared_and_who_acknowledged_it(
    tmp_path: Path, database: str
) -> None:
    async with publishing(tmp_path, database) as house:
        await published(house)
        keep(house, SCALES)
        alarms = house.services[SiteAlarms]
        alarm = alarms.list.alarms[alarm_key(None, None, "disk_low")]
        alarms.list.observe(alarm, True, unix_now())
        alarms.list.advance(UnixTime(unix_now() + 10))
        await alarms.list.write()
        await published(house)
        query = "SELECT priority, acknowledged_by FROM lineside.alarm WHERE code = 'disk_low'"
        assert rows(database, query) == [("low", None)]
        operator = await house.program(Role.OPERATOR)
        [shown] = (await operator.get("/api/v1/alarms?priority=low")).json()["alarms"]
        answer = await operator.post(f"/api/v1/alarms/{shown['id']}/acknowledge", json={"comment": "seen"})
        assert answer.status_code == 200, answer.text
        await published(house)
        found = rows(database, "SELECT acknowledged_by, comment FROM lineside.alarm WHERE code = 'disk_low'")
        assert found == [("key-operator", "seen")]


@pytest.mark.soak
async def test_a_day_away_leaves_everything_there_once(tmp_path: Path) -> None:
    """The database is away while a day of readings is stored, and the server ends and starts meanwhile."""
    start = minutes_ago(26 * 60) // 3600 * 3600
    with closing(OwnPostgresql()) as server:
        async with publishing(tmp_path / "site", server.url, "1 s") as house:
            await published(house)
            server.kill()
            keep(house, SCALES)
            for hour in range(24):
                keep(house, polls(start + 3600 * hour, start + 3600 * (hour + 1), each=2))
                await until(lambda: house.services[History].status.waiting == 0, "stored")
        async with publishing(tmp_path / "site", server.url, "1 s") as house:
            await _folded(house)
            server.start()
            publisher, now = house.services[Publisher], unix_now()
            async with asyncio.timeout(MAX_CATCH_UP_S):
                while publisher.status.until < now:  # noqa: ASYNC110
                    await asyncio.sleep(1)
            program = await house.program(Role.VIEWER)
            compared = 0
            for hour in range(24):
                span = start + 3600 * hour, start + 3600 * (hour + 1)
                compared += await compare_readings(program, server.url, *span, 1.0)
            assert compared == 24 * 3600 * 2 * 3
            [(first,)] = rows(server.url, "SELECT min(id) FROM lineside.event")
            await published(house)
            assert await compare_events(program, server.url, first) > 1


async def _folded(house: House) -> None:
    """Wait until every minute that is over is in its block."""
    async with asyncio.timeout(MAX_CATCH_UP_S):
        while await house.services[History].read(lambda _, tail: tail.everything()):  # noqa: ASYNC110
            await asyncio.sleep(1)


async def test_late_readings_of_a_published_minute_are_sent_too(tmp_path: Path, database: str) -> None:
    start = minutes_ago(6)
    every = polls(start, start + 240)
    # Each end of the server folds what came, into blocks that were published before.
    for updates in ([*SCALES, *every[::3]], every[1::3], every[2::3]):
        async with publishing(tmp_path, database) as house:
            await published(house)
            keep(house, updates)
            await published(house)
    async with publishing(tmp_path, database) as house:
        await published(house)
        program = await house.program(Role.VIEWER)
        query = {"bus": "dry-end", "unit": 1, "value": "actual", "points": 20_000, "format": "epoch"}
        span = {"from": iso(start), "to": iso(start + 300)}
        shown = (await program.get("/api/v1/history", params={**query, **span})).json()
    micros = "SELECT (extract(epoch FROM at) * 1000000)::bigint FROM lineside.reading WHERE unit = 1"
    there = {at for [at] in rows(database, micros)}
    served = {round(at * 1e6) for at in shown["t"]}
    assert len(served) > 200
    assert served <= there
