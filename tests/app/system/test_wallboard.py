"""The wallboard: which lines it has, and what of each."""

from __future__ import annotations

import re
from pathlib import Path

import httpx

from app.core.web.access import Role
from app.people.audit.log import EventLog
from app.system.peers.summary import LastEvents
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.played_line import played_line
from tests.app.system.test_lines_page import INLINE, two_lines


async def page(house: House, address: str = "/wallboard", language: str = "en") -> httpx.Response:
    viewer = await house.signed_in(Role.VIEWER, re.sub(r"\W", "-", address).strip("-"))
    return await viewer.get(address, headers={"Accept-Language": language})


async def test_it_has_every_line_in_the_order_of_the_configuration(tmp_path: Path) -> None:
    async with complete_app(tmp_path, config=two_lines(tmp_path)) as house:
        await played_line(house.services)
        text = (await page(house, language="de")).text
        assert re.findall(r'data-line="line_of/([a-z-]+)"', text) == ["dry-end", "wet-end"]
        assert 'data-wall="all"' in text
        assert not INLINE.search(text)
        assert text.count("section__roll") == 3
        assert '<nav class="rail"' not in text


async def test_one_line_by_its_name(tmp_path: Path) -> None:
    async with complete_app(tmp_path, config=two_lines(tmp_path)) as house:
        text = (await page(house, "/wallboard?bus=wet-end")).text
        assert re.findall(r'data-line="line_of/([a-z-]+)"', text) == ["wet-end"]
        assert 'data-wall="one"' in text
        unknown = await page(house, "/wallboard?bus=<script>")
        assert unknown.status_code == 404
        assert "<script>" not in unknown.text


async def test_the_last_event_names_unit_change_and_result(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        log, last = house.services[EventLog], house.services[LastEvents]
        change = {"what": Message("event_mode"), "bus": "dry-end", "unit": 1, "old": "1.0", "new": "2.0"}
        await log.record(kind="command", outcome="refused", **change)
        await log.record(kind="control", what="taken", bus="dry-end")
        await log.record(kind="run", what="of another line")
        await last.read()
        found = last.newest_of("dry-end")
        assert found is not None
        assert str(found.text) == "Unwind · mode: 1.0 → 2.0 · refused"
        await log.record(kind="command", outcome="verified", what="Set line", bus="dry-end")
        await last.read()
        assert str(last.newest_of("dry-end").text) == "Set line"  # type: ignore[union-attr]
        zero = {"old": "1: 119.4, 2: 118.0", "new": "1: 0.0, 2: 0.0", "who": "operator"}
        await log.record(
            kind="command", what=Message.of("event_zero_line", n=2), bus="dry-end", outcome="verified", **zero
        )
        await last.read()
        assert str(last.newest_of("dry-end").text) == "set 2 units to zero (operator)"  # type: ignore[union-attr]
        late = Message.of("event_readings_late", count=1, since="", until="")
        await log.record(kind="worker", what=late, bus="dry-end")
        await last.read()
        assert "to zero" in str(last.newest_of("dry-end").text)  # type: ignore[union-attr]
        for kind, what in (("bus", "port closed"), ("worker", "worker lost")):
            await log.record(kind=kind, what=what, bus="dry-end")
            await last.read()
            assert str(last.newest_of("dry-end").text) == what, "as on the page of events"  # type: ignore[union-attr]


async def test_the_last_event_is_beside_its_line(tmp_path: Path) -> None:
    async with complete_app(tmp_path, config=two_lines(tmp_path)) as house:
        await house.services[EventLog].record(kind="command", what="Set line", bus="wet-end")
        shown = (await page(house, "/wallboard?bus=wet-end")).text
        values = dict(re.findall(r'data-live="line_of/wet-end\.(\w+)"[^>]*>([^<]*)<', shown))
        assert values["event"] == "Set line"
        assert re.fullmatch(r"\d\d:\d\d", values["event_at"])


async def test_lines_show_the_speed_of_a_first_unit_with_its_age(tmp_path: Path) -> None:
    """So it keeps its last value, hatched, while the unit does not respond."""
    async with complete_app(tmp_path) as house:
        shown = (await page(house, "/lines")).text
        assert all(text in shown for text in ('data-live="dry-end/1.actual"', 'data-age="dry-end/1"'))
