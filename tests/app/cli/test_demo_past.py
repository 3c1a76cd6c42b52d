"""The past with which a demo begins."""

from __future__ import annotations

import asyncio
from collections import Counter
from contextlib import closing
from itertools import pairwise

import pytest

from app.cli.demo import configuration
from app.cli.past import PHASES, past_of, write_past
from app.core.database import Database
from app.engineering.sets.store import SetStore
from app.line.history import tables
from app.line.history.series.runs import HOUR, runs_of
from app.line.history.service import FILE
from app.line.history.writer import MIGRATIONS
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog, Filter
from app.people.audit.proof import heads_of
from app.settings import Settings, load
from bus.catalogue.parameters import ACCELERATION
from bus.instants import UnixTime, unix_now
from bus.simulator.plant import DemoLine, demo_line


@pytest.fixture(scope="module")
def line() -> DemoLine:
    return demo_line(8)


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory, line: DemoLine) -> Settings:
    folder = tmp_path_factory.mktemp("demo")
    file = folder / "lineside.toml"
    file.write_text(configuration(folder / "line", 8000, line.settings), encoding="utf-8")
    settings = load(file)
    write_past(settings, line)
    return settings


def test_the_log_of_the_past_is_intact_and_in_order_of_time(settings: Settings) -> None:
    with closing(Database(settings.server.store)) as database:
        keys = open_keys(settings.key_files, database.path, database.read_now(heads_of))
        events = EventLog(database, keys=keys)
        assert asyncio.run(events.proof.verify()).broken is None
        found, _ = asyncio.run(events.page(Filter(), 200))
        journal = [tuple(row) for row in database.read_now(_journal)]
        notes = database.read_now(lambda c: c.execute("SELECT count(*) FROM shift_note").fetchone()[0])
    times = [event["time"] for event in found]
    assert times == sorted(times, reverse=True)
    assert min(times) >= float(unix_now()) - 86_500
    assert float(unix_now()) - max(times) < 60, (
        "no sheet takes the time up to the demo for one without a record"
    )
    assert {event["origin"] for event in found} <= {"", "demo"}, "nothing of it passes for a person"
    kinds = Counter(event["kind"] for event in found)
    assert kinds["recipe"] == 4
    assert kinds["shift"] == notes == 8, "one about each incident, at its time, and one about the recipe"
    assert kinds["alarm"] == 6, "one of seven waits"
    for (alarm, occurrence, *_, after), (same, next_one, before, _) in pairwise(journal):
        assert (alarm, occurrence) != (same, next_one) or after == before


def _journal(connection: tables.StoreConnection) -> list[tuple[str, int, str, str]]:
    query = "SELECT alarm, occurrence, before, after FROM alarm_journal ORDER BY alarm, id"
    return connection.execute(query).fetchall()


def test_one_unit_departs_from_its_golden_set_in_one_value(settings: Settings, line: DemoLine) -> None:
    with closing(Database(settings.server.store)) as database:
        golden = asyncio.run(SetStore(database).golden("demo"))
    assert sorted(golden) == list(range(1, 9))
    memory = {unit.address: unit.memory for unit in line.plant.units}
    departs = {
        (unit, number)
        for unit, rows in golden.items()
        for number, row in rows.rows.items()
        if row.raw is not None and row.raw != memory[unit][number]
    }
    assert departs == {(3, ACCELERATION)}


def test_a_day_of_readings_with_the_bits_of_each_incident(settings: Settings) -> None:
    with closing(Database(settings.server.data / FILE, MIGRATIONS)) as database:

        def read(connection: tables.StoreConnection) -> tuple[list[int], list[tuple[int, int]]]:
            key = tables.find_unit(connection, "demo", 3)
            assert key is not None
            extent = tables.extent(connection)
            assert extent is not None
            runs = runs_of(zip(*tables.raw_columns(connection, key, *extent), strict=True))
            minutes = [
                (row.start, row.readings)
                for start in range(extent[0], extent[1], HOUR)
                for row in tables.rollups_of(connection, "minutes", key, start)
            ]
            return [sum(run.readings for run in runs), max(run.commanded for run in runs)], minutes

        (readings, highest), minutes = database.read_now(read)
    assert highest == 1200
    assert sum(count for _, count in minutes) == readings > 86_000
    assert len(minutes) in (1440, 1441)


def test_stretches_cover_the_day_of_every_unit(line: DemoLine) -> None:
    past = past_of(line, UnixTime(1_800_000_000.0))
    for unit in range(1, 9):
        stretches = list(past.stretches(unit))
        assert stretches[0].begins == past.begins
        assert all(one.ends == other.begins for one, other in pairwise(stretches))
        incidents = {each.incident for each in stretches if each.incident is not None}
        assert incidents == {each for each in past.incidents if each.unit == unit}
    assert PHASES[-1].share == 1.0, "the line goes on as the simulator begins"
