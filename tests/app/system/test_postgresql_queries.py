"""Each query of docs/plant-database.md and of its dashboard runs on the tables, and finds something."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import psycopg
import pytest

from app.line.history.series.figures import RunFigures, Series
from app.line.history.series.runs import MINUTE, Run, micros
from app.line.history.series.values import LinearScale, Scaling
from app.settings import load
from app.system.postgresql.destination import Destination
from app.system.postgresql.rows import (
    ALARM,
    EVENT,
    MINUTE_TABLE,
    READING,
    Batch,
    Scales,
    alarm_row,
    event_row,
    minute_rows,
    reading_rows,
)
from bus.instants import unix_now
from tests.app.plant_database import write_configuration
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = needs_postgresql
DOCS = Path(__file__).parents[3] / "docs"
QUERIES = re.findall(r"^```sql\n(.*?)^```", (DOCS / "plant-database.md").read_text("utf-8"), re.M | re.S)
BOARD = json.loads((DOCS / "deploy" / "grafana" / "plant.json").read_text("utf-8"))
SPAN = 32 * 60
"""Minutes up to now that the database has."""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[psycopg.Connection[Any]]:
    """Two units over more than a day: both ran, stood still for a while, switched an output, deviated."""
    with fresh_database() as url:
        settings = load(write_configuration(tmp_path_factory.mktemp("site"), url, "1 min"))
        assert settings.postgresql
        destination = Destination(settings.postgresql, settings.site.name, "0" * 32, settings.bus)
        destination.send(_batch(), unix_now())
        destination.abandon()
        with psycopg.connect(url, autocommit=True) as connection:
            yield connection


def _batch() -> Batch:
    batch, first = Batch(), micros(unix_now()) // MINUTE * MINUTE - SPAN * MINUTE
    scale = Scaling([0], [LinearScale(per=10, decimals=1)])
    for unit in (1, 2):
        place = ("dry-end", unit)
        runs = [_run(first + i * MINUTE, i, unit) for i in range(SPAN)]
        points = ((run.at, run) for run in runs)
        batch.add(READING, reading_rows(place, points, Scales(scale, scale, scale), 1))
        actual: list[float | None] = [run.actual / 10 for run in runs]
        series = Series([run.at for run in runs], actual, actual, actual)
        figures = {
            run.at: RunFigures(
                known=MINUTE, running=MINUTE * bool(run.actual), travel=float(run.actual * MINUTE)
            )
            for run in runs
        }
        batch.add(MINUTE_TABLE, minute_rows(place, series, [1] * SPAN, figures, 60))
    _add_entries(batch)
    return batch


def _run(at: int, number: int, unit: int) -> Run:
    actual = 0 if number % 60 in (10, 11) else 1000 + unit + number % 5
    word = (0xC0 | (2 if number % 7 else 0)) << 8 | 0b11
    return Run(at, at, 1, 1000, actual, 50, word)


def _add_entries(batch: Batch) -> None:
    now = float(unix_now())
    nothing = dict.fromkeys(EVENT.columns)
    command = {"kind": "command", "who": "anna", "bus": "dry-end", "unit": 1, "what": "set speed"}
    events = [
        {**nothing, **command, "id": 1, "time": now - 60, "hash": "a"},
        {
            **nothing,
            "id": 2,
            "time": now - 59,
            "kind": "fate",
            "about": 1,
            "outcome": "verified",
            "hash": "b",
        },
    ]
    batch.add(EVENT, map(event_row, events))
    alarm = {"alarm": "dry-end.1.deviation", "occurrence": 1, "code": "deviation", "name": "Deviation"}
    alarm |= {"bus": "dry-end", "unit": 1, "priority": "high", "who": "", "reason": ""}
    came = {**alarm, "at": now - 300, "trigger": "rise"}
    answered = {**alarm, "at": now - 200, "trigger": "acknowledge", "who": "anna"}
    row = alarm_row([came, answered])
    assert row is not None
    batch.add(ALARM, [row])


def test_there_are_ten() -> None:
    assert len(QUERIES) == 10


@pytest.mark.parametrize("query", QUERIES, ids=range(1, len(QUERIES) + 1))
def test_a_query_of_the_documentation_finds_rows(plant: psycopg.Connection[Any], query: str) -> None:
    if "2 hours" in query:
        # It is of the last night, and the test may run before six.
        query = query.replace("current_date", "(now() - interval '6 hours')::date")
    assert plant.execute(query.encode()).fetchall()


def test_the_stops_are_those_that_were(plant: psycopg.Connection[Any]) -> None:
    [query] = [query for query in QUERIES if "ran_again" in query]
    stops = plant.execute(query.encode()).fetchall()
    assert len(stops) in range(14, 19)
    assert {minutes for *_, minutes in stops[2:-2]} == {2}


@pytest.mark.parametrize("panel", BOARD["panels"], ids=lambda panel: panel["title"])
def test_a_panel_of_the_dashboard_finds_rows(plant: psycopg.Connection[Any], panel: dict[str, Any]) -> None:
    [target] = panel["targets"]
    assert plant.execute(_without_macros(target["rawSql"]).encode()).fetchall()


@pytest.mark.parametrize("variable", BOARD["templating"]["list"][1:], ids=lambda each: each["name"])
def test_the_choices_of_the_dashboard_are_found(
    plant: psycopg.Connection[Any], variable: dict[str, Any]
) -> None:
    assert plant.execute(_without_macros(variable["query"]).encode()).fetchall()


def _without_macros(query: str) -> str:
    """As Grafana replaces them."""
    now = datetime.now(UTC)
    span = f"BETWEEN '{(now - timedelta(hours=8)).isoformat()}' AND '{now.isoformat()}'"
    query = query.replace("$site", "Mill 7").replace("$bus", "dry-end").replace("$__interval", "1m")
    query = re.sub(r"\$__timeFilter\(([a-z.]+)\)", rf"\1 {span}", query)
    return re.sub(r"\$__timeGroup\(([a-z.]+), '?1[mh]'?\)", r"date_trunc('minute', \1)", query)
