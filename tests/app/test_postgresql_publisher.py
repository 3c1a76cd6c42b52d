"""The plant's database has what the site stores, row by row, whatever happens to either of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from app.web.admission.access import Role
from bus.contract import Update
from tests.app.plant_database import (
    SCALES,
    compare_events,
    compare_readings,
    keep,
    minutes_ago,
    published,
    publishing,
    reading,
    rows,
)
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = needs_postgresql


@pytest.fixture
def database() -> Iterator[str]:
    with fresh_database() as url:
        yield url


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


@pytest.mark.parametrize(("readings", "step"), [("all", 0.0), ("1 s", 1.0), ("10 s", 10.0)])
async def test_the_rows_are_what_the_api_serves(
    tmp_path: Path, database: str, readings: str, step: float
) -> None:
    start = minutes_ago(6)
    async with publishing(tmp_path, database, readings) as house:
        await published(house)
        keep(house, [*SCALES, *polls(start, start + 240)])
        await published(house)
        [(live,)] = rows(database, "SELECT count(*) FROM lineside.reading")
    # The end of a server folds its minutes, which are then sent as they are stored.
    async with publishing(tmp_path, database, readings) as house:
        await published(house)
        program = await house.program(Role.VIEWER)
        assert await compare_readings(program, database, start, start + 300, step) > 100
        [(first,)] = rows(database, "SELECT min(id) FROM lineside.event")
        await published(house)
        assert await compare_events(program, database, first) > 0
    assert live
