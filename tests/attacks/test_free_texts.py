"""Texts that people write for others: what would forge a line, hide, turn the text around it, or calculate in
a spreadsheet.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from io import StringIO
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.core.web.csv_file import guarded
from tests.app.complete_app import House
from tests.app.played_line import BUS, PlayedLine
from tests.for_each import for_each

LINE = "a\r\nboss: all alarms acknowledged"
HOSTILE = {
    "NUL": "a\0b",
    "line": LINE,
    "separator": "a\u2028b",
    "next line": "a\u0085b",
    "escape": "a\x1b[2Kb",
    "delete": "a\x7fb",
    "override": "a\u202eb",
    "isolate": "a\u2067b",
    "byte order mark": "\ufeffa",
    "no width": "a\u200bb",
    "tag": "a\U000e0041b",
    "nothing but a joiner": "\u200d",
    "nothing but a filler": "\u3164",
    "a tower of marks": "e" + "\u0301" * 9,
    "a tower with joiners": "e" + "\u0301\u200d" * 9,
    "ten thousand combining characters": "e" + "\u0301" * 10_000,
    "half a pair": "HALF",
}
SOME = ("line", "override", "half a pair")
"""Of each kind one: all are tried in one field, these in the others."""
READABLE = [
    "Nip\u202fÜ 2",
    "\u05d0\u200c\u05d1",
    "\u0645\u06cc\u200c\u062e",
    "\U0001f468\u200d\U0001f469",
    "Wickel\xadwerk",
]
OF_BUS = f"/api/v1/buses/{BUS}"
RECIPE = {"name": "Fine", "setpoints": {"1": 100}}
OWN_ALARM = {"name": "Slow", "bus": BUS, "unit": 1, "value": "actual", "above": "5"}
FIELDS: dict[str, tuple[str, Mapping[str, Any], str]] = {
    "block": (f"{OF_BUS}/units/1/block", {}, "reason"),
    "read-only": (f"{OF_BUS}/read-only", {"on": True}, "reason"),
    "set": (f"{OF_BUS}/sets", {"units": [1]}, "name"),
    "comment of a set": (f"{OF_BUS}/sets", {"units": [1]}, "comment"),
    "recipe": (f"{OF_BUS}/recipes", RECIPE, "name"),
    "comment of a recipe": (f"{OF_BUS}/recipes", RECIPE, "comment"),
    "maintenance": ("/api/v1/notifications/maintenance", {"minutes": 5}, "reason"),
    "note": ("/api/v1/shifts/notes", {"time": "2026-01-01T00:00:00Z"}, "text"),
    "own alarm": ("/api/v1/alarms/own", OWN_ALARM, "name"),
    "cause of an own alarm": ("/api/v1/alarms/own", OWN_ALARM, "cause"),
}
HAS_LINES = {"comment of a set", "comment of a recipe", "note"}


async def write(client: httpx.AsyncClient, field: str, text: str) -> httpx.Response:
    path, body, key = FIELDS[field]
    content = json.dumps({**body, key: text}).replace('"HALF"', '"\\ud800"')
    return await client.post(path, content=content, headers={"content-type": "application/json"})


@for_each("field", FIELDS)
async def test_a_text_that_hides_or_forges_is_refused(house: House, line: PlayedLine, field: str) -> None:
    del line
    client = await house.signed_in(Role.ADMIN)
    before = len((await client.get("/api/v1/events?limit=1000")).json()["events"])
    for name in HOSTILE if field == "block" else SOME:
        text = HOSTILE[name]
        if text == LINE and field in HAS_LINES:
            continue
        response = await write(client, field, text)
        assert (response.status_code, response.json()["code"]) == (422, "invalid"), name
    assert len((await client.get("/api/v1/events?limit=1000")).json()["events"]) == before


@for_each("text", READABLE)
async def test_a_text_of_any_script_is_shown_as_it_was_written(
    house: House, line: PlayedLine, text: str
) -> None:
    del line
    client = await house.signed_in(Role.ADMIN)
    assert (await write(client, "block", text)).json()["reason"] == text
    assert text in (await client.get(f"/units/{BUS}/1")).text


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=1+1", "'=1+1"),
        ("Nip;=1+1", "Nip;'=1+1"),
        ('Nip;"=1+1"', 'Nip;\'"=1+1"'),
        ("Nip; @SUM(1)", "Nip;' @SUM(1)"),
        ("Nip\n+1", "Nip\n'+1"),
        ("\uff1d1", "'\uff1d1"),
        ("a = b; c", "a = b; c"),
        ("-12.5", "-12.5"),
        ("\t=1+1", "'\t'=1+1"),
        ("\rNip", "'\rNip"),
    ],
)
def test_no_separator_of_a_spreadsheet_begins_a_formula(text: str, cell: str) -> None:
    assert guarded(text) == cell


async def test_a_formula_in_a_reason_is_text_in_the_events(house: House, line: PlayedLine) -> None:
    del line
    client = await house.signed_in(Role.ADMIN)
    assert (await write(client, "block", 'x;=HYPERLINK("http://x")')).status_code == 200
    text = (await client.get("/api/v1/events.csv")).text
    cells = [cell for row in csv.reader(StringIO(text), delimiter=";") for cell in row]
    assert any("HYPERLINK" in cell for cell in cells)
    assert not [cell for cell in cells if cell.lstrip().startswith("=")]
