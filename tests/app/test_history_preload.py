"""The first requests of the trends page, by its address: the rules of static/js/trends-view.js."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs

import pytest
from starlette.datastructures import QueryParams

from app.history.pages import preload_address
from app.history.series.runs import micros
from app.history.service import History
from app.settings import ServerSettings, Settings
from bus.settings import BusSettings, UnitSettings
from tests.app.history_line import NOON

UNITS = tuple(UnitSettings(id=number, name=f"Unit {number}") for number in range(1, 11))


@pytest.fixture
def history(tmp_path: Path) -> History:
    bus = BusSettings(name="line", port="/dev/null", unit=UNITS)
    return History(Settings(server=ServerSettings(data=tmp_path), bus=(bus,)))


def preloads(history: History, query: str) -> dict[str, list[str]]:
    path, _, found = preload_address(history, QueryParams(query), micros(NOON)).partition("?")
    assert path in ("", "/api/v1/history/series")
    return parse_qs(found)


def test_the_default_is_the_last_hour_of_the_first_units(history: History) -> None:
    found = preloads(history, "")
    assert found["series"] == [f"line/{number}/actual" for number in range(1, 9)]
    assert (found["from"], found["to"]) == (
        ["2026-11-21T11:00:00.000+00:00"],
        ["2026-11-21T12:00:00.000+00:00"],
    )


def test_an_address_is_followed_without_unknown_series(history: History) -> None:
    found = preloads(history, "s=line/3/run&s=line/99/run&s=line/3/nothing&s=line/1/analog&span=600")
    assert found["series"] == ["line/3/run", "line/1/analog"]
    assert found["from"] == ["2026-11-21T11:50:00.000+00:00"]
    fixed = preloads(history, "s=line/1/run&from=2026-11-20T00:00:00Z&to=2026-11-20T01:00:00Z")
    assert fixed["from"] == ["2026-11-20T00:00:00.000+00:00"]
    assert fixed["to"] == ["2026-11-20T01:00:00.000+00:00"]


@pytest.mark.parametrize(
    "query", ["s=", "span=x", "span=-5", "from=yesterday", "span=inf", "to=2026-11-20T01:00:00Z&span=nan"]
)
def test_what_makes_no_sense_is_left_to_the_page(history: History, query: str) -> None:
    assert preloads(history, query) == {}
