"""The page of all lines, and the same over the API and the socket of a page."""

from __future__ import annotations

import json
import re
from pathlib import Path

import msgspec

from app.live.browsers.browser import Browser
from app.live.browsers.hub import Hub
from app.live.screen.diff import Groups, merge_groups
from app.sites.fleet import Fleet
from app.sites.summary import end_notice, notices
from app.web.admission.access import Role
from tests.app.complete_app import EVERY_ROLE, House, complete_app
from tests.app.played_line import played_line
from tests.app.test_line_board import summary

INLINE = re.compile(r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son\w+=", re.IGNORECASE)


def report(house: House, *names: str, site: str = "Mill 7") -> None:
    """Another server reports lines."""
    lines = [msgspec.structs.replace(summary(name, "high", waiting=1), site=site) for name in names]
    for text in notices("app-2", lines):
        house.services[Fleet].board.take(text)


async def test_every_line_has_a_tile_that_leads_to_it(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        await played_line(house.services)
        report(house, "wet-end", "coater", site="Mill 8")
        viewer = await house.signed_in(Role.VIEWER)
        page = (await viewer.get("/lines", headers={"Accept-Language": "de"})).text
        assert re.findall(r'href="/\?bus=([a-z-]+)"', page) == ["coater", "wet-end", "dry-end"]
        assert "Keine Antwort seit" in page
        assert "Alle 2 Regler auf null" in page
        assert not INLINE.search(page)
        only = (await viewer.get("/lines", params={"site": "Mill 8"})).text
        assert re.findall(r'href="/\?bus=([a-z-]+)"', only) == ["coater", "wet-end"]
        unknown = (await viewer.get("/lines", params={"site": "<script>"})).text
        assert re.findall(r'href="/\?bus=([a-z-]+)"', unknown) == ["coater", "wet-end", "dry-end"]
        assert "<script>" not in unknown


async def test_the_link_is_in_the_frame_where_there_is_a_choice(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        viewer = await house.signed_in(Role.VIEWER)
        assert 'href="/lines"' not in (await viewer.get("/")).text
        report(house, "wet-end")
        assert 'href="/lines"' in (await viewer.get("/")).text


async def test_programs_get_the_same(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        await played_line(house.services)
        report(house, "wet-end", site="Mill 8")
        statuses = {
            role: (await (await house.program(role)).get("/api/v1/sites")).status_code for role in EVERY_ROLE
        }
        assert statuses == {**dict.fromkeys(EVERY_ROLE, 200), Role.WORKER: 403}
        viewer = house.clients[0]
        found = (await viewer.get("/api/v1/sites")).json()["lines"]
        wet, dry = found
        assert (wet["bus"], wet["site"], wet["home"], wet["level"]) == ("wet-end", "Mill 8", "app-2", "high")
        assert wet["verdict"]["code"] == "unit_offline"
        assert wet["alarms"]["unacknowledged"] == {"high": 1}
        assert wet["stale"] is False
        assert (dry["bus"], dry["level"], dry["verdict"]["code"]) == ("dry-end", None, "line_at_zero")
        assert dry["states"] == {"online": 2, "at_zero": 2}
        only = (await viewer.get("/api/v1/sites", params={"site": "Mill 8"})).json()["lines"]
        assert [line["bus"] for line in only] == ["wet-end"]


async def test_a_page_that_follows_the_lines_gets_them_and_their_changes(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        report(house, "wet-end")
        hub, follower, other = house.services[Hub], *(Browser("ann", "viewer", "en") for _ in range(2))
        for browser in (follower, other):
            hub.join(browser)
        hub.follow(follower, (), "", lines=True)
        complete = await _lines(follower)
        assert complete["line_of/wet-end"]["quality"] == "live"
        assert set(complete["line_of/dry-end"]) >= {"level", "verdict", "rank", "spark"}
        hub.tick()
        await _lines(follower)
        house.services[Fleet].board.take(end_notice("app-2"))
        hub.tick()
        hub.tick()
        changed = await _lines(follower)
        assert changed["line_of/wet-end"]["quality"] == "stale"
        assert "home" not in changed["line_of/wet-end"]
        assert await _lines(other) == {}
        hub.follow(follower, (), "")
        hub.tick()
        assert await _lines(follower) == {}


async def _lines(browser: Browser) -> Groups:
    """The fields of lines among what a page is sent now."""
    messages = [json.loads(text) for text in await browser.next()]
    return merge_groups({}, *(message["f"] for message in messages if message["is"] == "lines"))
