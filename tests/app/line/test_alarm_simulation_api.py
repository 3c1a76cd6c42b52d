"""A proposed alarm over HTTP and on the page of the site's alarms, in both languages. 3 s."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.errors import Problem
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.own_condition import in_toml, proposed
from app.line.alarms.settings import AlarmSettings
from app.line.alarms.simulation import Simulator
from app.line.history import tables
from app.line.history.series.runs import micros
from app.line.history.service import History
from app.settings import load
from bus.contract import ParameterValue, Reading
from bus.instants import UnixTime
from tests.app.complete_app import House, complete_app
from tests.app.history_line import until

BUS = "dry-end"
PATH = "/api/v1/alarms/simulate"
ABOVE = {"bus": BUS, "unit": 1, "value": "actual", "above": "105.0"}


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Unit 1 ran at 100.0 in the last ten minutes, three times too fast for 2 s within half a minute."""
    async with complete_app(tmp_path) as house:
        now = time.time() - 600
        fast = [*range(60, 62), *range(70, 72), *range(80, 82)]
        readings = [
            Reading(1, UnixTime(now + second), 1000, 1100 if second in fast else 1000, 51, 0xC0, 3)
            for second in range(600)
        ]
        history = house.services[History]
        history.append(BUS, [ParameterValue(1, 3, UnixTime(now - 1), 1), *readings])
        await asyncio.to_thread(until, lambda: history.status.waiting == 0)
        yield house


async def simulated(client: httpx.AsyncClient, **body: Any) -> dict[str, Any]:
    response = await client.post(PATH, json={**ABOVE, **body})
    assert response.status_code == 200, response.text
    found: dict[str, Any] = response.json()
    return found


async def test_an_engineer_learns_how_often_it_would_have_come(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    found = await simulated(engineer)
    assert (found["annunciated"], found["chattering"], found["complete"]) == (3, 3, True)
    assert (found["standing_s"], found["longest_s"], found["stands_at_end"]) == (6, 2, False)
    assert found["covered_from"] > found["from"]
    assert found["first"] < found["last"] < found["covered_to"]
    assert (await simulated(engineer, on_delay_s=5))["annunciated"] == 0
    assert (await simulated(engineer, off_delay_s=20, above=105))["annunciated"] == 1
    other = await simulated(engineer, unit=2)
    assert (other["covered_from"], other["annunciated"], other["unknown_s"]) == (None, 0, 0)
    past = await simulated(engineer, **{"from": "2020-01-01T00:00:00Z", "to": "2020-01-02T00:00:00Z"})
    assert past["covered_from"] is None
    unscaled = await simulated(engineer, value="analog")
    assert (unscaled["annunciated"], unscaled["unknown_s"]) == (0, pytest.approx(600, abs=70))
    assert not house.services[LineAlarms].buses[BUS].list.take_unwritten()[0]


async def test_readings_that_are_stored_no_longer_are_not_judged(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    engineer = await house.program(Role.ENGINEER)
    before = await simulated(engineer)
    given_up = micros(UnixTime(time.time() - 525))
    monkeypatch.setattr(tables, "raw_from", lambda _: given_up)
    after = await simulated(engineer)
    assert (before["annunciated"], after["annunciated"]) == (3, 1)
    assert before["covered_from"] < after["covered_from"] < after["first"]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"unit": 9}, "bus dry-end has no unit 9"),
        ({"bus": "wet-end"}, "there is no bus wet-end"),
        ({"above": "10", "deadband": "11"}, "deadband is wider than the limits leave room for"),
        ({"below": "90", "deadband": "8"}, "would never clear"),
        ({"on_delay_s": -1}, "on_delay_s = -1"),
        ({"above": "fast"}, "above = 'fast'"),
        ({"value": "run"}, "run is on or off"),
        ({"from": "2026-01-01T00:00:00Z", "to": "2026-03-01T00:00:00Z"}, "at most 31 days at once"),
        ({"from": "2026-01-02T00:00:00Z", "to": "2026-01-01T00:00:00Z"}, ""),
        ({"name": ""}, "name = ''"),
        ({"speed": 1}, ""),
    ],
)
async def test_a_fault_is_named(house: House, body: dict[str, Any], words: str) -> None:
    engineer = await house.program(Role.ENGINEER)
    response = await engineer.post(PATH, json={**ABOVE, **body})
    assert response.status_code == 422
    assert words in response.json()["detail"]


def test_a_key_that_is_missing_is_named_alone() -> None:
    with pytest.raises(Problem) as refused:
        proposed({"name": "Web break", "bus": "dry-end", "unit": 1}, [])
    assert str(refused.value.message) == "value is missing"


async def test_only_an_engineer_may_simulate(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    assert (await operator.post(PATH, json=ABOVE)).status_code == 403
    assert (await operator.get("/alarms/own")).status_code == 403
    assert "/alarms/own" not in (await operator.get("/alarms")).text


async def test_the_work_of_one_is_bounded_and_that_is_stated(house: House) -> None:
    history = house.services[History]
    settings = AlarmSettings(name="x", **{**ABOVE, "value": "actual"})
    now = UnixTime(time.time())
    found = await Simulator(history, work_s=0.0).run(
        history.buses[BUS], settings, UnixTime(now - 3600), now, "anna"
    )
    assert (found.complete, found.covered_to, found.annunciated) == (False, found.covered_from, 0)


async def test_the_page_has_the_form_the_result_and_the_entry(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    query = {"place": f"{BUS}/1", "value": "actual", "above": "105.0", "days": "1", "name": "Too fast"}
    page = (await engineer.get("/alarms/own", params=query)).text
    assert "The alarm would have come 3 times. 3 of them chattering." in page
    assert "History begins at" in page
    assert "name = &#34;Too fast&#34;" in page
    german = {"Accept-Language": "de"}
    page = (await engineer.get("/alarms/own", params={**query, "above": "105,0"}, headers=german)).text
    assert "Der Alarm wäre 3-mal gekommen." in page
    for change, words in (
        ({"on_delay_s": "-1"}, "on_delay_s = -1.0"),
        ({"place": f"{BUS}/9"}, "has no unit 9"),
        ({"on_delay_s": "soon"}, "on_delay_s = &#39;soon&#39;"),
    ):
        refused = await engineer.get("/alarms/own", params=query | change)
        assert (refused.status_code, words in refused.text) == (422, True)
        assert 'value="Too fast"' in refused.text


async def test_nothing_stored_is_not_zero_on_the_page(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    page = (await engineer.get("/alarms/own", params={"place": f"{BUS}/2", "above": "1"})).text
    assert "Nothing of this time is stored." in page
    assert "The alarm would have come" not in page


def test_the_entry_can_be_pasted_into_the_configuration(tmp_path: Path) -> None:
    written = {"name": 'A "quoted" \\ name', "bus": BUS, "unit": 4, "value": "deviation", "above": "2.50"}
    written |= {"deadband": "0.5", "on_delay_s": 5.0, "priority": "high", "latch": True}
    settings = AlarmSettings.model_validate(written)
    path = tmp_path / "lineside.toml"
    unit = f'[[bus]]\nname = "{BUS}"\nport = "/dev/null"\n[[bus.unit]]\nid = 4\nname = "Nip"\n'
    path.write_text(unit + in_toml(settings))
    (read,) = load(path).alarm
    assert read == settings
