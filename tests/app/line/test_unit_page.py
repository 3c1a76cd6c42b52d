"""The page of a unit as the server sends it: neighbors, alarms in words, the way to a replacement."""

from __future__ import annotations

import re
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.core.web.access import Role
from app.line.live.bus_live import LiveState
from bus.contract import Reading
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, HEALTHY, REMOTE, played_line

UNIT = f"/units/{BUS}/1"
PROTOCOL = re.compile(r"\b8[0-9]h\b|#\d+\b")


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        await played_line(house.services)
        yield house


def estop(house: House, *, active: bool) -> None:
    live = house.services[LiveState].buses[BUS]
    live.apply([Reading(1, time.time(), 0, 0, 0, REMOTE, 0 if active else HEALTHY)])


async def test_its_alarm_is_in_words_with_its_time_and_a_way_to_its_response(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    estop(house, active=True)
    page = (await operator.get(UNIT)).text
    link = rf'href="/alarms/{BUS}\.1\.estop_active\.1".*?Emergency stop.*?active since \d\d:\d\d'
    assert re.search(link, page, re.DOTALL)


async def test_the_neighbors_are_those_of_the_floor_and_open_in_the_same_view(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    first, second = (await client.get(UNIT)).text, (await client.get(f"/units/{BUS}/2/parameters")).text
    assert ('rel="prev"' in first, f'href="/units/{BUS}/2" rel="next"' in first) == (False, True)
    assert f'href="/units/{BUS}/1/parameters" rel="prev"' in second


async def test_words_of_the_protocol_are_under_details_alone(house: House) -> None:
    page = (await (await house.signed_in(Role.ENGINEER)).get(UNIT)).text
    shown, details = page[page.index("<main") :].split('<details class="card plate__more">')
    assert PROTOCOL.findall(re.sub(r"<[^>]*>", " ", shown)) == []
    assert "84h" in details


async def test_who_may_replace_a_unit_finds_it_before_every_other_button(house: House) -> None:
    for role, may in ((Role.VIEWER, False), (Role.ENGINEER, True)):
        page = (await (await house.signed_in(role)).get(UNIT)).text
        plate = page[page.index('class="plate"') :]
        assert ("Replace this unit" in plate) is may
        first = re.search(r'class="button[^>]*>([^<]*)', plate)
        assert (first is not None and first[1] == "Replace this unit") is may
