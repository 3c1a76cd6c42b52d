"""The lines of others over the plant's broker: shown with their age, and only as what their topic permits."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from app.line.live.browser import Browser
from app.line.live.hub import Hub
from app.system.mqtt.node import LINES
from app.system.mqtt.session import Nodes
from app.system.peers.board import LineBoard, LineTiles
from bus.messages import in_english
from tests.app.broker import Broker, running
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import until
from tests.app.system.test_mqtt_broker import configuration, site


@asynccontextmanager
async def overview(folder: Path, broker: Broker) -> AsyncIterator[tuple[House, LineBoard]]:
    """Run a server without a line of its own, which shows those of the broker."""
    url = f"mqtt://127.0.0.1:{broker.port}"
    config = configuration(folder, url, "overview = true", "Plant", bus=False)
    async with complete_app(folder, config=config) as house:
        yield house, house.services[LineTiles].board


def is_live(board: LineBoard) -> bool:
    """Return whether there are lines and all are of the present."""
    lines = board.lines()
    return bool(lines) and not any(line.is_stale for line in lines)


async def test_an_overview_shows_the_lines_of_the_broker_with_their_age(tmp_path: Path) -> None:
    async with running(tmp_path) as broker, overview(tmp_path / "overview", broker) as (house, board):
        async with site(
            tmp_path / "site", broker, '[notify]\ndashboard_url = "https://mill7:8443"'
        ) as publisher:
            await publisher.worker()
            await until(lambda: is_live(board), "the line is shown")
            (line,) = board.lines()
            assert (line.bus, line.site, line.href) == (
                "dry-end",
                "Mill 7",
                "https://mill7:8443/?bus=dry-end",
            )
            lines = house.services[Nodes].overview
            assert lines is not None
            assert in_english(lines.state()).endswith(f"{broker.port}: lines of others that are shown: 1")
            shown = (await house.http("viewer").get("/api/v1/sites")).json()
            assert [(each["bus"], each["peer"], each["units"]) for each in shown["lines"]] == [
                ("dry-end", "Mill 7", 3)
            ]
        async with broker.client() as other:
            for number, payload in enumerate((b"{}", b"x" * 100_000, b'{"page": "javascript:1"}', b"\xff")):
                await other.publish(f"{LINES}/evil/{number}", payload, qos=1, retain=True)
            await other.publish(f"{LINES}/Mill 7/dry-end", b"", qos=1, retain=True)
            await until(lambda: not board.lines(), "a line that was taken away is gone")


async def quality_on_page(house: House) -> str:
    """Return how a page that opens now is shown the one line."""
    browser, hub = Browser("ann", "viewer", "en"), house.services[Hub]
    hub.join(browser)
    hub.follow(browser, (), "", lines=True)
    messages = [json.loads(text) for text in await browser.next()]
    (line,) = (fields for message in messages if message["is"] == "lines" for fields in message["f"].values())
    return str(line["quality"])


async def test_the_pages_of_a_copy_that_is_gone_are_shown_the_truth_by_another(tmp_path: Path) -> None:
    """A copy keeps nothing: another one has the document that the broker kept, which is not of the present,
    until the next one."""
    async with running(tmp_path) as broker:
        async with site(tmp_path / "site", broker), overview(tmp_path / "first", broker) as (first, board):
            await until(lambda: is_live(board), "the line is shown")
            assert await quality_on_page(first) == "live"
        async with overview(tmp_path / "second", broker) as (second, board):
            await until(board.lines, "the document is read")
            assert await quality_on_page(second) == "stale"
            async with site(tmp_path / "site", broker):
                await until(lambda: is_live(board), "the line is published again")
                assert await quality_on_page(second) == "live"


async def test_a_server_with_lines_does_not_show_its_own_twice(tmp_path: Path) -> None:
    async with (
        running(tmp_path) as broker,
        overview(tmp_path / "overview", broker) as (_, others),
        site(tmp_path / "site", broker, "overview = true") as house,
    ):
        await until(lambda: is_live(others), "the document is read elsewhere")
        assert [line.peer for line in house.services[LineTiles].board.lines()] == [None]


async def test_a_foreign_document_is_not_shown_as_ours(tmp_path: Path) -> None:
    """A document is shown under the group and bus of its topic, whatever it says of itself."""
    async with running(tmp_path) as broker, overview(tmp_path / "overview", broker) as (_, board):
        async with site(tmp_path / "site", broker), broker.client() as other:
            await until(lambda: is_live(board), "the line is shown")
            genuine: list[bytes] = []
            await other.subscribe(f"{LINES}/Mill 7/dry-end")
            async for message in other.messages:
                genuine.append(bytes(message.payload))
                break
            forged = json.dumps(json.loads(genuine[0]) | {"instance": "forged"}).encode()
            await other.publish(f"{LINES}/Evil/dry-end", forged, qos=1)
            await other.publish(f"{LINES}/Mill 7/wet-end", forged, qos=1)
            await until(lambda: len(board.lines()) == 2, "it is shown as what it is")
        await asyncio.sleep(0.2)
        assert sorted((line.site, line.bus) for line in board.lines()) == [
            ("Mill 7", "dry-end"),
            ("Mill 7 (Evil)", "dry-end"),
        ]
