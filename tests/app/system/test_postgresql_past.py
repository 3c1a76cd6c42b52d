"""``lineside publish`` fills a past in, and ``lineside audit verify --postgresql`` compares."""

from __future__ import annotations

import json
from pathlib import Path

import psycopg
import pytest
from click.testing import CliRunner, Result

from app.cli.audit import audit
from app.cli.publish import publish
from app.cli.status import status
from app.core.web.access import Role
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
    write_configuration,
)
from tests.postgresql import fresh_database, needs_postgresql
from tests.sizes import sizes

pytestmark = needs_postgresql


def called(folder: Path, *words: str) -> Result:
    command = audit if words[0] == "verify" else publish
    given = words if words[0] == "verify" else words[1:]
    return CliRunner().invoke(command, [*given, "--config", str(folder / "lineside.toml")])


def minutes(database: str) -> int:
    [(count,)] = rows(database, "SELECT count(*) FROM lineside.minute")
    return int(count)


@pytest.mark.parametrize("readings", sizes("1 s", "all"))
async def test_a_past_is_filled_in_once(tmp_path: Path, database: str, readings: str) -> None:
    start = minutes_ago(8)
    # Stored before anything was published: an empty database has another cursor.
    with fresh_database() as elsewhere:
        async with publishing(tmp_path, elsewhere, readings) as house:
            updates = [reading(1 + i % 2, start + i / 4, 500 + i % 13) for i in range(900)]
            keep(house, [*SCALES, *updates])
            await published(house)
        # The end of the server makes blocks of what it has stored: they are published elsewhere, too.
        async with publishing(tmp_path, elsewhere, readings) as house:
            await published(house)
    async with publishing(tmp_path, database, readings) as house:
        await published(house)
        program = await house.program(Role.VIEWER)
        assert minutes(database) == 0
        for _ in range(2):
            result = called(tmp_path, "publish", "--from", iso(start - 3600))
            assert result.exit_code == 0, result.output
            assert "rows from" in result.output
            step = 1.0 if readings == "1 s" else 0.0
            assert await compare_readings(program, database, start, start + 300, step) > 300
        await published(house)
        assert await compare_events(program, database, 1) > 2
    assert minutes(database) == 8


def test_a_span_that_cannot_be_is_refused(tmp_path: Path) -> None:
    write_configuration(tmp_path, "postgresql://db/plant", "1 s")
    reversed_span = called(tmp_path, "publish", "--from", "2026-02-01", "--to", "2026-01-01")
    assert "before --to" in str(reversed_span.exception)
    assert "write a day" in str(called(tmp_path, "publish", "--from", "yesterday").exception)


async def test_events_are_a_second_witness_of_the_log(tmp_path: Path, database: str) -> None:
    async with publishing(tmp_path, database) as house:
        await published(house)
        await house.add("anna", Role.OPERATOR)
        await published(house)
    assert called(tmp_path, "publish", "--from", "2020-01-01").exit_code == 0
    result = called(tmp_path, "verify", "--postgresql")
    assert result.exit_code == 0, result.output
    assert "each with the same hash" in result.output
    shown = CliRunner().invoke(status, ["--json", "--config", str(tmp_path / "lineside.toml")])
    assert json.loads(shown.stdout)["publisher"]["lag_s"] < 600
    with psycopg.connect(database, autocommit=True) as connection:
        connection.execute("UPDATE lineside.event SET hash = 'forged' WHERE id = 2")
    result = called(tmp_path, "verify", "--postgresql")
    assert result.exit_code != 0
    assert "entry 2 with another hash" in str(result.exception)
