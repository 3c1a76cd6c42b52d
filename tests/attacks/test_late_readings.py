"""A stolen worker token against the history: nothing that is stored changes, or gets another beside it."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from app.line.feed.bus_feed import BusFeed, Credential
from app.line.feed.ingest import MAX_VALUES_AT_ONCE
from app.line.feed.socket import Workers
from app.line.history import tables
from app.line.history.recorder import Tail
from app.line.history.series.runs import HOUR, Run, merge, micros
from app.line.history.service import History
from app.line.live.change_recorder import ChangeRecorder
from bus.contract import MAX_UPDATES, Batch, Reading, Snapshot, UnitState, encode
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import hello, reading, snapshot, unit_state, until
from tests.attacks.test_feed import HostileSocket

BUS = "dry-end"
DAY_S = 86_400.0


async def connect(house: House, *batches: Batch, state: Snapshot | None = None, worker: str = "w1") -> None:
    """One connection from its hello to its announced end."""
    messages = [encode(each) for each in (hello(worker), state or snapshot(), *batches)]
    await house.services[Workers].serve(HostileSocket(messages), Credential("stolen", BUS, "192.0.2.66"))


def of(begin: float, actual: int, count: int = 10, each_s: float = 1.0) -> list[Any]:
    """Readings of unit 1 from a time on."""
    return [replace(reading(1, actual), at=begin + place * each_s) for place in range(count)]


async def stored(house: House, begin: float, end: float) -> list[int]:
    """The actual speed of every reading of unit 1 that history has, once all that came is written."""
    history = house.services[History]
    await until(lambda: history.status.waiting == 0, "everything stored")

    def read(connection: tables.StoreConnection, tail: Tail) -> list[Run]:
        key, span = tables.find_unit(connection, BUS, 1), (micros(begin), micros(end))
        if key is None:
            return []
        recent = tail.runs(key, *span)
        # A minute that is folded between the two reads is in both.
        columns = tables.raw_columns(connection, key, span[0] - HOUR, span[1])
        blocks = merge(zip(*columns, strict=True), recent)
        return [run for run in blocks if span[0] <= run.at < span[1]]

    return [run.actual for run in await history.read(read) for _ in range(run.readings)]


async def refusals(house: House) -> list[dict[str, Any]]:
    await house.services.buses[BUS][ChangeRecorder].recorded()
    return [each for each in await house.events("worker") if "refused" in each["what"]]


@asynccontextmanager
async def followed(folder: Path, at: float) -> AsyncIterator[House]:
    """An app whose bus was followed at that time, with 5000 as stored; started again since."""
    async with complete_app(folder) as house:
        house.services.buses[BUS][BusFeed].coverage.until = at - 1
        await connect(house, Batch(1, at, of(at, 5000), live=False), worker="before")
        assert await stored(house, at - 1, at + 100) == [5000] * 10
    async with complete_app(folder) as house:
        yield house


async def test_nothing_is_stored_beside_stored_readings(tmp_path: Path) -> None:
    begin = time.time() - 7 * DAY_S + 3600
    async with followed(tmp_path, begin) as house:
        forged = of(begin + 0.5, 1, 9)
        for live in (False, True):
            await connect(house, Batch(1, time.time(), forged, live=live), worker=f"forger {live}")
        assert await stored(house, begin - 1, begin + 100) == [5000] * 10
        refused = await refusals(house)
        # Of the last seconds, which a worker sends again after a crash, it is left out in silence.
        assert sum(int(event["new"]) for event in refused) == 2 * len(forged) - 10
        assert "of a time that the bus worker reported before" in refused[0]["message"]


async def test_the_time_that_the_app_was_away_is_delivered_once(tmp_path: Path) -> None:
    begin = time.time() - 3600
    async with followed(tmp_path, begin) as house:
        await connect(house, Batch(1, time.time(), of(begin + 60, 6000), live=False))
        assert await stored(house, begin - 1, begin + 100) == [5000] * 10 + [6000] * 10
        await connect(house, Batch(2, time.time(), of(begin + 60.5, 1, 8), live=False), worker="forger")
        assert await stored(house, begin - 1, begin + 100) == [5000] * 10 + [6000] * 10


async def test_a_forged_parameter_scales_nothing_that_is_stored(tmp_path: Path) -> None:
    """Decimals (#3) from three months ago would show all of it a hundredth as large."""
    begin = time.time() - 3600
    async with followed(tmp_path, begin) as house:
        state = unit_state(1, {3: 4})
        long_ago = [replace(value, at=begin - 90 * DAY_S) for value in state.parameters]
        forged = UnitState(state.unit, state.link, None, long_ago)
        await connect(house, state=replace(snapshot(), units=[forged]), worker="forger")
        await stored(house, begin, begin + 1)
        steps = await house.services[History].read(
            lambda store, _: store.execute("SELECT at FROM parameter WHERE raw = 4").fetchall()
        )
        assert all(at > micros(begin) for (at,) in steps)


async def test_more_than_a_wire_carries_is_refused_and_summed_up(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        feed, begin = house.services.buses[BUS][BusFeed], time.time() - 3 * DAY_S
        feed.coverage.until = begin
        flood = [
            Batch(1 + number, time.time(), _tight(begin + 60 * number), live=False)
            for number in range(int(MAX_VALUES_AT_ONCE) // MAX_UPDATES + 20)
        ]
        feed._quota._updates.capacity = 1e9  # the test does not wait until the rest is read
        feed._quota._values.per_s = 1e-9  # however long the test takes, no more is admitted meanwhile
        await connect(house, *flood)
        refused = [event for event in await refusals(house) if "bus can carry" in event["message"]]
        assert 0 < len(refused) <= 2, "one at once, and their sum"
        total = sum(int(event["new"]) for event in refused)
        assert 19 * MAX_UPDATES < total <= 20 * MAX_UPDATES
        await until(lambda: house.services[History].status.waiting == 0, "everything stored")


def _tight(begin: float) -> Sequence[Reading]:
    return of(begin, 1, MAX_UPDATES, 0.01)
