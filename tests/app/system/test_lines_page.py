"""The page of all lines, and the same over the API and the socket of a page."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path

from app.core.web.access import Role
from app.line.live.browser import Browser
from app.line.live.bus_live import LiveState
from app.line.live.fields import Groups, merge_groups
from app.line.live.hub import Hub
from app.system.peers.summary import FRESH_S
from bus.instants import unix_now
from tests.app.complete_app import EVERY_ROLE, complete_app
from tests.app.played_line import played_line

INLINE = re.compile(r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son\w+=", re.IGNORECASE)


CONFIGURATION = """
[site]
name = "Mill 7"
[[bus]]
name = "dry-end"
port = "/dev/null"
unit = [{id = 1, name = "Unwind"}, {id = 2, name = "Nip"}]
[[bus]]
name = "wet-end"
port = "socket://192.0.2.9:4001"
unit = [{id = 1, name = "Couch"}]
"""


def two_lines(folder: Path) -> Path:
    """A configuration with two buses; no worker of either runs."""
    folder.mkdir(exist_ok=True)
    config = folder / "lineside.toml"
    config.write_text(CONFIGURATION)
    return config


async def test_every_line_has_a_tile_that_leads_to_it(tmp_path: Path) -> None:
    async with complete_app(tmp_path, config=two_lines(tmp_path)) as house:
        await played_line(house.services)
        viewer = await house.signed_in(Role.VIEWER)
        page = (await viewer.get("/lines", headers={"Accept-Language": "de"})).text
        assert re.findall(r'href="/\?bus=([a-z-]+)"', page) == ["wet-end", "dry-end"]
        assert "Alle 2 Regler auf null" in page
        assert not INLINE.search(page)
        unknown = (await viewer.get("/lines", params={"site": "<script>"})).text
        assert re.findall(r'href="/\?bus=([a-z-]+)"', unknown) == ["wet-end", "dry-end"]
        assert "<script>" not in unknown


async def test_the_link_is_in_the_frame_where_there_is_a_choice(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        assert 'href="/lines"' not in (await (await house.signed_in(Role.VIEWER)).get("/")).text
    async with complete_app(tmp_path, config=two_lines(tmp_path / "two")) as house:
        assert 'href="/lines"' in (await (await house.signed_in(Role.VIEWER)).get("/")).text


async def test_programs_get_the_same(tmp_path: Path) -> None:
    async with complete_app(tmp_path, config=two_lines(tmp_path)) as house:
        await played_line(house.services)
        statuses = {
            role: (await (await house.program(role)).get("/api/v1/sites")).status_code for role in EVERY_ROLE
        }
        assert statuses == {**dict.fromkeys(EVERY_ROLE, 200), Role.WORKER: 403}
        viewer = house.clients[0]
        wet, dry = (await viewer.get("/api/v1/sites")).json()["lines"]
        assert (wet["bus"], wet["site"], wet["level"]) == ("wet-end", "Mill 7", "urgent")
        assert wet["verdict"]["code"] == "worker_lost"
        assert (dry["bus"], dry["level"], dry["verdict"]["code"]) == ("dry-end", None, "line_at_zero")
        assert (dry["stale"], dry["age_s"]) == (False, 0.0)
        assert dry["states"] == {"online": 2, "at_zero": 2}
        for site, buses in (("Mill 7", ["wet-end", "dry-end"]), ("Mill 8", [])):
            found = (await viewer.get("/api/v1/sites", params={"site": site})).json()["lines"]
            assert [line["bus"] for line in found] == buses


async def test_a_page_that_follows_the_lines_gets_them_and_their_changes(tmp_path: Path) -> None:
    async with complete_app(tmp_path, config=two_lines(tmp_path)) as house:
        await played_line(house.services)
        hub, follower, other = house.services[Hub], *(Browser("ann", "viewer", "en") for _ in range(2))
        for browser in (follower, other):
            hub.join(browser)
        hub.follow(follower, (), "", lines=True)
        complete = await _lines(follower)
        assert complete["line_of/dry-end"]["level"] == ""
        assert set(complete["line_of/wet-end"]) >= {"level", "verdict", "rank", "spark"}
        hub.tick()
        await _lines(follower)
        house.services[LiveState].buses["dry-end"].lose_worker(unix_now())
        await asyncio.sleep(FRESH_S)
        hub.tick()
        hub.tick()
        changed = await _lines(follower)
        assert changed["line_of/dry-end"]["level"] == "urgent"
        assert await _lines(other) == {}
        hub.follow(follower, (), "")
        hub.tick()
        assert await _lines(follower) == {}


async def _lines(browser: Browser) -> Groups:
    """The fields of lines among what a page is sent now."""
    messages = [json.loads(text) for text in await browser.next()]
    return merge_groups({}, *(message["f"] for message in messages if message["is"] == "lines"))
