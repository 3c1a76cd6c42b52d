from __future__ import annotations

import asyncio
import json
from typing import Any

from app.line.live.browser import MAX_FRAMES, Browser, Diff


def diff(n: int, **fields: str) -> Diff:
    return Diff(n - 1, n, 100.0 + n, {"dry/1": fields} if fields else {})


async def sent(browser: Browser) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await browser.next()]


async def test_a_diff_is_sent_as_it_was_encoded_for_all() -> None:
    browser = Browser("anna", "operator", "en")
    one = diff(1, actual="1")
    browser.send_diff(one)
    assert await browser.next() == [one.text]
    assert json.loads(one.text) == {"is": "diff", "p": 0, "n": 1, "t": 101.0, "f": {"dry/1": {"actual": "1"}}}


async def test_newest_wins_for_a_slow_browser_and_nothing_is_queued() -> None:
    browser = Browser("anna", "operator", "en")
    for n in range(1, 1001):
        browser.send_diff(diff(n, actual=str(n)))
    browser.send_diff(diff(1001, mode="local"))
    (only,) = await sent(browser)
    assert only["f"] == {"dry/1": {"actual": "1000", "mode": "local"}}
    assert (only["p"], only["n"], only["t"]) == (0, 1001, 1101.0)


async def test_a_merged_diff_leaves_the_shared_one_as_it_was() -> None:
    browser = Browser("anna", "operator", "en")
    first = diff(1, actual="1")
    browser.send_diff(first)
    browser.send_diff(diff(2, actual="2"))
    assert first.groups == {"dry/1": {"actual": "1"}}


async def test_all_who_missed_the_same_get_the_same_text() -> None:
    one, other = Browser("anna", "operator", "en"), Browser("bernd", "viewer", "en")
    for each in [diff(n, actual=str(n)) for n in range(1, 500)]:
        one.send_diff(each)
        other.send_diff(each)
    assert (await one.next())[0] is (await other.next())[0]


async def test_a_snapshot_makes_what_was_pending_worthless() -> None:
    browser = Browser("anna", "operator", "en")
    browser.send_diff(diff(1, actual="1"))
    browser.send({"is": "snapshot", "n": 1})
    browser.send_diff(diff(2, actual="2"))
    assert [(message["is"], message["n"]) for message in await sent(browser)] == [
        ("snapshot", 1),
        ("diff", 2),
    ]


async def test_frames_are_bounded() -> None:
    browser = Browser("anna", "operator", "en")
    browser.show_frames([{"hex": str(n)} for n in range(MAX_FRAMES + 50)])
    (message,) = await sent(browser)
    assert len(message["frames"]) == MAX_FRAMES
    assert message["frames"][0] == {"hex": "50"}


async def test_what_a_busy_socket_missed_goes_together() -> None:
    browser = Browser("anna", "operator", "en")
    waiting = asyncio.create_task(browser.next())
    await asyncio.sleep(0)
    browser.send_diff(diff(1, actual="1"))
    browser.send_diff(diff(2, actual="2"))
    (first,) = await waiting
    assert (json.loads(first)["p"], json.loads(first)["n"]) == (0, 2)
    browser.send_diff(diff(3, actual="3"))
    assert [message["n"] for message in await sent(browser)] == [3]
