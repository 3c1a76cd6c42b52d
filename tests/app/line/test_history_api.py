"""GET /api/v1/history and its relatives: the contract, the limits, the refusals, and the exports."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from pyarrow import parquet
from starlette.types import ASGIApp, Receive, Scope, Send

from app.core.database import Database
from app.core.web.access import Person, Role
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.problems import install
from app.core.web.routes import Turns
from app.core.web.services import Registry
from app.core.web.shape import iso
from app.core.web.templating import Templates
from app.line.history import export, tables
from app.line.history.api import router
from app.line.history.export import MAX_ROWS, STEPS, Cell, ExportRow, Together, step_of
from app.line.history.recorder import Recorder, Tail
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, Rollup, Run, combine, micros, pack_rollups
from app.line.history.service import FILE, History
from app.line.history.writer import MIGRATIONS
from app.people.audit.log import EventLog
from app.settings import Site
from bus.contract import UnitLink
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import UnitSettings
from tests.app import measured_export
from tests.app.history_line import BUS, NOON, parameter, polls, reading, until
from tests.for_each import for_each

TWO_UNITS = BUS.model_copy(update={"unit": (*BUS.unit, UnitSettings(id=2, name="Nip"))})


class AsViewer:
    """Makes every request that of a viewer, or without an account by the header X-Anonymous."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if b"x-anonymous" not in dict(scope.get("headers", [])):
            scope["caller"] = Person("viewer", Role.VIEWER, "token")
        await self.app(scope, receive, send)


@pytest.fixture
async def history(tmp_path: Path) -> AsyncIterator[History]:
    history = History(tmp_path, [TWO_UNITS], time_zone="Europe/Berlin")
    history.start()
    yield history
    history.close()


@pytest.fixture
async def client(history: History, tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    database = Database(tmp_path / "lineside.db")
    events = EventLog(database, clock=lambda: NOON + 5)
    await events.record(kind="mode", what="mode", bus="dry-end", unit=1, old="LOCAL", new="REMOTE")
    await events.record(kind="mode", what="mode", bus="dry-end", unit=2, old="LOCAL", new="REMOTE")
    await events.record(kind="login", what="logged in", who="anna")
    app = FastAPI()
    templates = Templates(templates_dir(), Assets(static_dir()), Site())
    app.state.services = Registry((history, events, templates, Turns()))
    app.router.routes.extend(router.routes)
    app.add_middleware(AsViewer)
    install(app)
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://line/api/v1") as client:
        yield client
    database.close()


def at(offset: float) -> str:
    return datetime.fromtimestamp(NOON + offset, UTC).isoformat()


def query(**changes: Any) -> dict[str, Any]:
    fields = {"bus": "dry-end", "unit": 1, "value": "actual", "from": at(0), "to": at(20), "points": 1000}
    return {name: value for name, value in {**fields, **changes}.items() if value is not None}


def fill(history: History) -> None:
    """Store twenty seconds of readings with a gap of three."""
    history.append(
        "dry-end", [parameter(3, 1), parameter(22, 0), parameter(23, 100), *polls(NOON, NOON + 10)]
    )
    history.append("dry-end", [UnitLink(1, NOON + 11, "offline"), UnitLink(1, NOON + 13, "online")])
    history.append("dry-end", polls(NOON + 13, NOON + 20))
    until(lambda: history.status.waiting == 0)


async def test_columns_in_display_units_with_a_null_for_the_gap(
    client: httpx.AsyncClient, history: History
) -> None:
    fill(history)
    found = (await client.get("/history", params=query())).json()
    assert len({len(found[name]) for name in ("t", "min", "max", "avg")}) == 1
    assert found["min"] == found["max"] == found["avg"]
    assert found["avg"][:3] == [100.0, 100.1, 100.2]
    hole = found["avg"].index(None)
    assert at(9.8) <= found["t"][hole] <= at(13)
    assert (found["decimals"], found["resolution"], found["bucket_s"]) == (1, "readings", 0)
    moments = [datetime.fromisoformat(t) for t in found["t"]]
    assert moments == sorted(moments)
    assert all(moment.tzinfo is not None for moment in moments)


async def test_fewer_points_keep_the_extremes(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    found = (await client.get("/history", params=query(points=8))).json()
    assert len(found["t"]) <= 8
    assert min(v for v in found["min"] if v is not None) == 100.0
    assert max(v for v in found["max"] if v is not None) == 100.6
    assert found["bucket_s"] > 0


async def test_every_kind_of_value_is_there(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    wanted = {"commanded": 100.0, "analog": 20.0, "run": 1.0, "at_speed": 1.0, "remote": 1.0}
    for value in (*wanted, "estop", "slave", "output.6"):
        found = (await client.get("/history", params=query(value=value))).json()
        assert {v for v in found["avg"] if v is not None} == {wanted.get(value, 0.0)}, value


async def test_a_unit_that_never_responded_has_empty_columns(client: httpx.AsyncClient) -> None:
    found = (await client.get("/history", params=query())).json()
    assert (found["t"], found["avg"]) == ([], [])


@for_each(
    ("changes", "status", "word"),
    [
        ({"from": at(20), "to": at(0)}, 422, "be before its end"),
        ({"from": "2026-11-21T12:00:00"}, 422, "zone"),
        ({"to": "yesterday"}, 422, "ISO 8601"),
        ({"from": "0001-01-01T00:00:00+23:59"}, 422, "from 1970 to 9998"),
        ({"points": 1_000_000}, 422, "20000"),
        ({"value": "output.7"}, 422, "output.6"),
        ({"unit": 9}, 404, "unit 9"),
        ({"bus": "wet-end"}, 404, "dry-end"),
        ({"format": "stars"}, 422, "format"),
    ],
)
async def test_an_impossible_query_is_refused_with_a_reason(
    client: httpx.AsyncClient, changes: dict[str, Any], status: int, word: str
) -> None:
    response = await client.get("/history", params=query(**changes))
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    assert word in response.json()["detail"]


async def test_an_unescaped_plus_is_understood(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    span = f"from={at(0)}&to={at(20)}"
    assert "+" in span
    found = await client.get(f"/history?bus=dry-end&unit=1&value=actual&{span}")
    assert found.status_code == 200
    assert len(found.json()["t"]) > 50


async def test_several_values_come_together(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    series = ["dry-end/1/actual", "dry-end/1/run"]
    params = {"series": series, "from": at(0), "to": at(20), "format": "epoch"}
    found = (await client.get("/history/series", params=params)).json()
    assert [(one["unit"], one["value"]) for one in found] == [(1, "actual"), (1, "run")]
    assert found[0]["t"][0] == NOON
    refused = await client.get("/history/series", params={**params, "series": ["dry-end/1/actual"] * 33})
    assert refused.status_code == 422
    assert (await client.get("/history/series", params={**params, "series": ["dry-end"]})).status_code == 422


async def test_small_pictures_of_many_units(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    params = {"series": ["dry-end/1/actual"], "from": at(0), "to": at(20)}
    found = (await client.get("/history/sparks", params=params)).json()
    spark = found["dry-end/1/actual"]
    assert len(spark["t"]) <= 120
    params = {**params, "format": "epoch"}
    epoch = (await client.get("/history/sparks", params=params)).json()["dry-end/1/actual"]
    assert [iso(seconds) for seconds in epoch["t"]] == spark["t"]
    assert None in found["dry-end/1/actual"]["avg"]


async def test_marks_are_what_happened_to_the_units_shown(client: httpx.AsyncClient) -> None:
    params = {"from": at(0), "to": at(20), "unit": ["dry-end/1"]}
    found = (await client.get("/history/marks", params=params)).json()
    assert [(mark["kind"], mark["unit"], mark["t"]) for mark in found["marks"]] == [
        ("mode", 1, iso(NOON + 5))
    ]
    assert found["marks"][0]["shown"] == {"what": "mode", "old": "LOCAL", "new": "REMOTE"}
    assert found["more"] is False
    epoch = (await client.get("/history/marks", params={**params, "format": "epoch"})).json()
    assert [mark["t"] for mark in epoch["marks"]] == [NOON + 5]
    later = (await client.get("/history/marks", params={"from": at(10), "to": at(20)})).json()
    assert later["marks"] == []


async def test_readings_that_came_late_are_a_mark_of_their_span(
    client: httpx.AsyncClient, tmp_path: Path
) -> None:
    """Whenever they came, and however much of the span is shown."""
    with closing(Database(tmp_path / "lineside.db")) as database:
        for code, span in (("event_history_follows", (30, 60)), ("event_readings_late", (80, 90))):
            begin, end = (iso(NOON + each) for each in span)
            what = Message.of(code, count=100, since=begin, until=end)
            await EventLog(database).record(kind="server", what=what, at=UnixTime(NOON + 3600))

    async def spans(start: float, end: float) -> list[tuple[float, float | None]]:
        params = {"from": at(start), "to": at(end), "format": "epoch", "unit": "dry-end/1"}
        marks = (await client.get("/history/marks", params=params)).json()["marks"]
        return [(mark["t"] - NOON, mark["until"] and mark["until"] - NOON) for mark in marks]

    assert await spans(0, 20) == [(5, None)]
    assert await spans(0, 50) == [(5, None), (30, 60)]
    assert await spans(40, 85) == [(30, 60), (80, 90)]
    assert await spans(3500, 3700) == [], "not when they came"
    params = {"from": at(20), "to": at(40)}
    [mark] = (await client.get("/history/marks", params=params)).json()["marks"]
    assert (mark["t"], mark["until"]) == (iso(NOON + 30), iso(NOON + 60))
    assert "100 readings" in mark["shown"]["what"]


async def test_csv_names_units_and_time_zone(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    series = ["dry-end/1/actual", "dry-end/1/run"]
    response = await client.get("/history/export", params={"series": series, "from": at(0), "to": at(20)})
    assert response.headers["content-type"] == "text/csv; charset=utf-8"
    assert ".csv" in response.headers["content-disposition"]
    rows = list(csv.reader(io.StringIO(response.text)))
    assert rows[0] == ["time [Europe/Berlin]", "dry-end/1 actual", "dry-end/1 run", "note"]
    assert rows[1] == ["2026-11-21T13:00:00.000+01:00", "100.0", "1", ""]
    holes = [row for row in rows[1:] if row[-1]]
    assert [(row[1], row[3]) for row in holes] == [("", "no readings of dry-end/1")]
    assert len(rows) == 1 + 50 + 1 + 35


async def test_a_value_that_is_steady_from_before_the_start_is_in_an_export(
    client: httpx.AsyncClient, history: History
) -> None:
    """A row for people at each second; of single readings the last, when the unit responded."""
    scale = [parameter(3, 1), parameter(22, 0), parameter(23, 100)]
    history.append("dry-end", [*scale, *polls(NOON, NOON + 30, lambda _: 1000)])
    until(lambda: history.status.waiting == 0)
    params = {"series": ["dry-end/1/actual"], "from": at(10), "to": at(20)}
    table = await client.get("/history/export", params={**params, "layout": "table"})
    rows = list(csv.reader(io.StringIO(table.content.decode("utf-8-sig"))))[1:]
    assert [row[0][-8:] for row in rows] == [f"13:00:{second}" for second in range(10, 20)]
    assert {row[2] for row in rows} == {"100.0"}
    single = list(csv.reader(io.StringIO((await client.get("/history/export", params=params)).text)))[1:]
    assert [row[1] for row in single] == ["100.0"]
    assert single[0][0] == "2026-11-21T13:00:29.800+01:00"


async def test_a_unit_that_does_not_come_back_is_empty_in_a_table(
    client: httpx.AsyncClient, history: History
) -> None:
    scale = [
        parameter(number, raw, unit=unit) for unit in (1, 2) for number, raw in ((3, 1), (22, 0), (23, 100))
    ]
    other = [reading(NOON + second / 2, unit=2) for second in range(120)]
    history.append("dry-end", [*scale, *polls(NOON, NOON + 5, lambda _: 1000), *other])
    until(lambda: history.status.waiting == 0)
    params = {"series": ["dry-end/1/actual", "dry-end/2/actual"], "layout": "table"}

    async def shown(start: float, end: float) -> list[tuple[str, str]]:
        response = await client.get("/history/export", params={**params, "from": at(start), "to": at(end)})
        rows = list(csv.reader(io.StringIO(response.content.decode("utf-8-sig"))))[1:]
        return [(row[2], row[3]) for row in rows]

    assert await shown(0, 40) == [("100.0", "100.0")] * 5 + [("", "100.0")] * 35
    assert await shown(20, 40) == [("", "100.0")] * 20


@pytest.mark.parametrize("resolution", ["readings", "minutes"])
async def test_a_draw_is_a_column_of_a_table_without_the_speeds_that_were_not_chosen(
    client: httpx.AsyncClient, history: History, resolution: str
) -> None:
    scale = [
        parameter(number, raw, unit=unit) for unit in (1, 2) for number, raw in ((3, 1), (22, 0), (23, 100))
    ]
    before = [reading(NOON + second / 2, 1000, unit=1) for second in range(80)]
    section = [reading(NOON + second / 2, 1035, unit=2) for second in range(240)]
    history.append("dry-end", [*scale, *before, *section])
    until(lambda: history.status.waiting == 0)
    chosen = ["dry-end/2/draw", "dry-end/2/actual"]
    params = {"series": chosen, "layout": "table", "from": at(0), "to": at(120), "resolution": resolution}
    response = await client.get("/history/export", params=params)
    [head, *rows] = csv.reader(io.StringIO(response.content.decode("utf-8-sig")))
    if resolution == "readings":
        assert [text.split(" ", 1)[1] for text in head[2:]] == ["draw [%]", "actual"]
        assert [row[2:] for row in rows] == [["3.50", "103.5"]] * 40 + [["", "103.5"]] * 80
    else:
        assert [text.split(" ", 1)[1] for text in head[2:4]] == ["draw minimum [%]", "draw maximum [%]"]
        assert [row[2:5] for row in rows] == [["3.50"] * 3, [""] * 3]


async def test_an_export_before_anything_is_folded_holds_what_a_worker_kept_for_days(
    client: httpx.AsyncClient, history: History, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recorder, "fold", lambda *_: None)
    two_days_ago = time.time() // 60 * 60 - 2 * 86_400
    history.append("dry-end", [parameter(3, 1), parameter(23, 100), *polls(two_days_ago, two_days_ago + 2)])
    until(lambda: history.status.waiting == 0)
    params = {"series": ["dry-end/1/actual"], "from": datetime.fromtimestamp(two_days_ago, UTC).isoformat()}
    rows = list(csv.reader(io.StringIO((await client.get("/history/export", params=params)).text)))
    assert len(rows) == 1 + 10


async def test_parquet_holds_the_same(client: httpx.AsyncClient, history: History) -> None:
    fill(history)
    params = {"series": ["dry-end/1/actual"], "from": at(0), "to": at(20), "format": "parquet"}
    response = await client.get("/history/export", params=params)
    table = parquet.read_table(io.BytesIO(response.content))
    assert table.schema.metadata[b"time_zone"] == b"Europe/Berlin"
    values = table.column("dry-end/1 actual").to_pylist()
    assert len(values) == 50 + 1 + 35
    assert values[:2] == [100.0, 100.1]
    assert table.column("time").to_pylist()[0] == datetime.fromtimestamp(NOON, UTC)


async def test_an_export_reads_the_tail_before_the_store(
    client: httpx.AsyncClient, history: History, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A minute that is folded in between is in neither of them otherwise."""
    fill(history)
    order = list[str]()
    still, runs = export.snapshot, Tail.runs

    def stand_still(connection: tables.StoreConnection) -> AbstractContextManager[None]:
        order.append("store")
        return still(connection)

    def read_tail(*args: Any) -> list[Run]:
        order.append("tail")
        return runs(*args)

    monkeypatch.setattr(export, "snapshot", stand_still)
    monkeypatch.setattr(Tail, "runs", read_tail)
    params = {"series": ["dry-end/1/actual", "dry-end/1/commanded"], "from": at(0), "to": at(20)}
    assert (await client.get("/history/export", params=params)).status_code == 200
    assert order == ["tail", "store"]


async def test_parquet_without_pyarrow_is_refused_in_words(
    client: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    params = {"series": ["dry-end/1/actual"], "format": "parquet"}
    response = await client.get("/history/export", params=params)
    assert (response.status_code, response.json()["code"]) == (501, "no_parquet")
    assert "lineside[parquet]" in response.json()["detail"]
    assert (await client.get("/history/export", params={**params, "format": "csv"})).status_code == 200


async def test_a_pyarrow_that_does_not_fit_is_refused_like_none(
    client: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "pyarrow").mkdir()
    (tmp_path / "pyarrow/__init__.py").write_text("raise AttributeError('_ARRAY_API not found')")
    for name in [name for name in sys.modules if name.partition(".")[0] == "pyarrow"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    params = {"series": ["dry-end/1/actual"], "format": "parquet"}
    response = await client.get("/history/export", params=params)
    assert (response.status_code, response.json()["code"]) == (501, "no_parquet")


async def test_an_export_by_minutes_has_least_greatest_and_average(
    client: httpx.AsyncClient, history: History
) -> None:
    fill(history)
    params = {"series": ["dry-end/1/actual"], "from": at(0), "to": at(20), "resolution": "minutes"}
    rows = list(csv.reader(io.StringIO((await client.get("/history/export", params=params)).text)))
    assert rows[0][1:4] == [f"dry-end/1 actual {part}" for part in ("min", "max", "avg")]
    assert [rows[1][1], rows[1][2]] == ["100.0", "100.6"]


async def test_an_export_of_nothing_has_its_headings(client: httpx.AsyncClient) -> None:
    response = await client.get("/history/export", params={"series": ["dry-end/1/actual"]})
    assert response.text.splitlines() == ["time [Europe/Berlin],dry-end/1 actual,note"]


async def test_a_failing_store_is_reported_and_the_rest_goes_on(tmp_path: Path) -> None:
    # Not damaged content: the writer replaces that at its next commit.
    (tmp_path / "history.db").mkdir()
    history = History(tmp_path, [BUS])
    history.start()
    app = FastAPI()
    app.state.services = Registry((history, Turns()))
    app.router.routes.extend(router.routes)
    app.add_middleware(AsViewer)
    install(app)
    base = "http://line/api/v1"
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=base) as client:
        status = (await client.get("/history/status")).json()
        assert status["state"] == "failed"
        assert datetime.fromisoformat(status["since"]).tzinfo is not None
        response = await client.get("/history", params=query())
        assert response.status_code == 503
        assert "no history is stored" in json.loads(response.content)["detail"]
    history.append("dry-end", polls(NOON, NOON + 1))
    history.close()


async def test_the_default_span_is_the_last_hour(client: httpx.AsyncClient, history: History) -> None:
    now = time.time()
    history.append("dry-end", polls(now - 60, now - 50))
    until(lambda: history.status.waiting == 0)
    found = (await client.get("/history", params=query(**{"from": None, "to": None}))).json()
    assert len(found["t"]) == 50


S = SECOND


def row(seconds: float, *values: float | None, ends: tuple[int, ...] = ()) -> ExportRow:
    cells = tuple(None if value is None else Cell(value, 0) for value in values)
    return ExportRow(round(seconds * S), cells, "", ends)


def together(*pieces: list[ExportRow], end: float = 100) -> list[tuple[float, list[float | None]]]:
    table = Together(2, S)
    rows = [each for piece in pieces for each in table.rows(piece)] + list(table.end(round(end * S)))
    return [(row.at / S, [cell and cell.value for cell in row.cells]) for row in rows]


def test_units_that_respond_at_different_times_share_rows() -> None:
    assert together([row(1.2, 10, None), row(1.4, None, 7), row(2.1, 11, None), row(2.3, None, 8)]) == [
        (2, [10, 7]),
        (3, [11, 8]),
    ]


def test_a_reading_at_the_time_itself_counts_and_a_steady_value_holds_over_pieces() -> None:
    assert together([row(1, 10, 7)], [row(3, 11, 7)]) == [(1, [10, 7]), (2, [10, 7]), (3, [11, 7])]


def test_a_hole_ends_the_values_of_its_unit_alone() -> None:
    found = together([row(1, 10, 7), row(1.5, None, None, ends=(0,)), row(3, None, 8), row(4, 12, 8)])
    assert found == [(1, [10, 7]), (2, [None, 7]), (3, [None, 8]), (4, [12, 8])]


def test_a_time_at_which_nothing_is_known_has_no_row() -> None:
    found = together([row(1, 10, 7), row(1.5, None, None, ends=(0, 1)), row(900.5, 12, 8)], end=1000)
    assert found == [(1, [10, 7]), (901, [12, 8])]


def test_nothing_follows_the_end() -> None:
    assert together([row(1.5, 10, 7)], end=1.8) == []
    assert together([]) == []


def test_a_long_span_has_a_longer_step() -> None:
    assert step_of(0, 3600 * S) == S
    assert step_of(0, 3 * DAY) == 5 * S
    assert step_of(0, 3650 * DAY) == STEPS[-1]
    assert 3 * DAY / step_of(0, 3 * DAY) <= MAX_ROWS


MAX_GROWTH_MB = 100
"""All rows at once would be half as much again and more."""


DAYS = 60


@pytest.fixture(scope="module")
def months(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A store with the minutes of these days, and when that ends."""
    folder = tmp_path_factory.mktemp("months")
    end = micros(time.time()) // DAY * DAY
    minutes = [_minute(n) for n in range(60)]
    blob = pack_rollups(minutes, 0)
    hours = pack_rollups([combine(minutes, hour * HOUR) for hour in range(24)], 0)

    def write(connection: tables.StoreConnection) -> None:
        unit = tables.unit_id(connection, "line", 1)
        starts = range(end - DAYS * DAY, end, HOUR)
        insert = "INSERT INTO {} VALUES (?, ?, ?)"
        connection.executemany(insert.format("minutes"), [(unit, start, blob) for start in starts])
        midnights = range(end - DAYS * DAY, end, DAY)
        connection.executemany(insert.format("hours"), [(unit, day, hours) for day in midnights])
        tables.write_raw_from(connection, end)

    database = Database(folder / FILE, MIGRATIONS)
    database.write_now(write)
    database.close()
    return folder, end


def _minute(number: int) -> Rollup:
    low, high = 1000 + number, 1100 - number
    reach = (low, high, 300 * (low + high) // 2)
    return Rollup(number * MINUTE, 300, *reach, *reach, *reach, 3, 3, (300, 300, *[0] * 14))


@pytest.mark.soak
@pytest.mark.parametrize("file", ["csv", "parquet"])
def test_months_do_not_fill_memory(months: tuple[Path, int], file: str) -> None:
    folder, end = months
    span = (str(end - DAYS * DAY), str(end))
    done = subprocess.run(
        [sys.executable, "-m", measured_export.__name__, str(folder), file, *span],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    measured = json.loads(done.stdout.splitlines()[-1])
    rows = DAYS * 1440
    if file == "csv":
        with (folder / "export").open() as lines:
            assert sum(1 for _ in lines) == rows + 1
    else:
        assert parquet.ParquetFile(folder / "export").metadata.num_rows == rows
    assert measured["grown_mb"] < MAX_GROWTH_MB, measured
