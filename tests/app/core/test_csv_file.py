"""Every download of CSV: for programs as the API documents it, and for the spreadsheet of a reader."""

from __future__ import annotations

import csv
import re
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import httpx
import pytest
import pytest_asyncio
from fastapi.routing import APIRoute

import app
from app.core.messages import Languages
from app.core.web.access import Role
from app.core.web.csv_file import Column, CsvForm, Number, reader_form
from bus.messages import Message, term
from tests.app.complete_app import House
from tests.app.records.test_reports import BEGIN, SPAN, mill
from tests.for_each import for_each

pytestmark = pytest.mark.asyncio(loop_scope="module")
ZONE = "Europe/Berlin"
SERIES = {"series": ["dry-end/1/actual", "dry-end/2/actual"], "resolution": "readings"}
DOWNLOADS: dict[str, dict[str, Any]] = {
    "/api/v1/events.csv": {},
    "/api/v1/alarms/performance.csv": {},
    "/api/v1/report/units.csv": SPAN,
    "/api/v1/report/stops.csv": SPAN,
    "/api/v1/history/export": {**SPAN, **SERIES},
}
HEADINGS = {
    "/api/v1/events.csv": "id,time,kind,who,origin,bus,unit,what,old,new,old_raw,new_raw,outcome,"
    "message,count",
    "/api/v1/alarms/performance.csv": "code,value,at_most,at_least,met,from,to,observed_s",
    "/api/v1/report/units.csv": "bus,unit,name,start,end,known_s,running_s,length,length_unit,stops,"
    "stopped_s,at_speed_s,unread_s,speed_average,speed_greatest,speed_unit,draw_average,draw_least,draw_greatest,"
    "alarms,commands,by_minute",
    "/api/v1/report/stops.csv": "bus,unit,name,began,ended,seconds,reason,before,goes_on",
    "/api/v1/history/export": f"time [{ZONE}],dry-end/1 actual [m/min],dry-end/2 actual [m/min],note",
}
LOCAL = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d")
FORMULA = re.compile(r"(?![+-]\d\d:\d\d$|-[\d,.]+$)[=+@\t\r-]")
"""But for a negative number and an offset from UTC."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def house(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[House]:
    """Two units, of which the second has the name of a formula, and an event with one."""
    async with mill(tmp_path_factory.mktemp("site"), zone=ZONE) as made:
        await made.add("@SUM", Role.VIEWER)
        yield made


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def german(house: House) -> httpx.AsyncClient:
    client = await house.program(Role.VIEWER)
    client.headers["Accept-Language"] = "de"
    return client


def cells(text: str, delimiter: str) -> list[list[str]]:
    return list(csv.reader(StringIO(text, newline=""), delimiter=delimiter))


async def test_every_download_is_one_of_these(house: House) -> None:
    routes = [route for route in house.app.routes if isinstance(route, APIRoute)]
    of_csv = {route.path for route in routes if "text/csv" in route.responses.get(200, {}).get("content", {})}
    assert of_csv == DOWNLOADS.keys()
    writers = [
        path.name
        for path in Path(app.__file__).parent.rglob("*.py")
        if re.search(r"^\s*(import|from) csv\b", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert writers == ["csv_file.py"]


@for_each("path", DOWNLOADS)
async def test_programs_get_what_the_api_documents(german: httpx.AsyncClient, path: str) -> None:
    response = await german.get(path, params=DOWNLOADS[path])
    assert response.status_code == 200
    assert response.text.split("\r\n")[0] == HEADINGS[path]


@for_each("path", DOWNLOADS)
async def test_a_german_reader_gets_what_a_german_spreadsheet_takes(
    german: httpx.AsyncClient, path: str
) -> None:
    response = await german.get(path, params={**DOWNLOADS[path], "form": "reader"})
    assert response.content.startswith(b"\xef\xbb\xbf")
    head, *rows = cells(response.text.removeprefix("\ufeff"), ";")
    assert rows
    assert {len(row) for row in rows} == {len(head)}
    assert not set(head) & (set(HEADINGS[path].split(",")) - {"code"}), "headings in English"
    for row in rows:
        offsets = [cell for name, cell in zip(head, row, strict=True) if name == "Abstand zu UTC" and cell]
        assert set(offsets) <= {"+01:00", "+02:00"}
        assert not [cell for cell in row if re.fullmatch(r"-?\d+\.\d+", cell)], row
        assert len([cell for cell in row if LOCAL.fullmatch(cell)]) == len(offsets)


@for_each("form", ["data", "reader"])
@for_each("path", DOWNLOADS)
async def test_no_cell_is_a_formula(german: httpx.AsyncClient, path: str, form: str) -> None:
    response = await german.get(path, params={**DOWNLOADS[path], "form": form, "layout": "table"})
    for delimiter in ",;":
        found = cells(response.text.removeprefix("\ufeff"), delimiter)
        assert not [cell for row in found for cell in row if FORMULA.match(cell)]


async def test_times_and_numbers_of_a_report_in_german(german: httpx.AsyncClient) -> None:
    response = await german.get("/api/v1/report/stops.csv", params={**SPAN, "form": "reader"})
    head, first, second = cells(response.text.removeprefix("\ufeff"), ";")
    assert head[:5] == ["Bus", "Regler", "Name", "Beginn", "Abstand zu UTC"]
    began = datetime.fromtimestamp(BEGIN + 60, ZoneInfo(ZONE))
    assert first[:5] == ["dry-end", "1", "Unwind", f"{began:%Y-%m-%d %H:%M:%S}", f"{began:%z}"[:3] + ":00"]
    assert first[-4:] == ["29,0", "Sollgeschwindigkeit 0", "nein", "nein"]
    assert second[2] == "'=Nip"


async def test_the_table_of_the_history_stays_as_it_was_for_programs(german: httpx.AsyncClient) -> None:
    query = {**SPAN, **SERIES, "layout": "table"}
    text = (await german.get("/api/v1/history/export", params=query)).text.removeprefix("\ufeff")
    assert cells(text, ",")[1][2] == "60.0"
    reader = (await german.get("/api/v1/history/export", params={**query, "form": "reader"})).text
    assert cells(reader.removeprefix("\ufeff"), ";")[1][2] == "60,0"


async def test_cells_by_their_kind() -> None:
    columns = (Column("a", term("Time"), is_time=True), *(Column(name, term("Value")) for name in "bcdefg"))
    at = datetime(2026, 10, 25, 0, 30, tzinfo=UTC)
    row = (at, -1.5, Number("12.50"), True, None, "=1.5", Message("unknown_code_of_test"))
    german = reader_form(Languages()["de"], ZONE)
    assert german.rows(columns, [row]).startswith("2026-10-25 02:30:00;+02:00;-1,5;12,50;ja;;'=1.5;")
    assert CsvForm().rows(columns, [row]).startswith("2026-10-25T00:30:00.000+00:00,-1.5,12.50,True,,'=1.5,")
    english = reader_form(Languages()["en"], "UTC")
    assert english.rows(columns[:2], [row[:2]]) == "2026-10-25 00:30:00,+00:00,-1.5\r\n"
