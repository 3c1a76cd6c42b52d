from __future__ import annotations

import json
from typing import Any

import pytest

from app.live.browser import FEW_PAGES, FLOOD, MOST_FRAMES, MOST_TOLD_S, WINDOW_S, Browser, Diff, Flow


def diff(n: int, **fields: str) -> Diff:
    return Diff(n - 1, n, 100.0 + n, {"dry/1": fields} if fields else {})


async def told(browser: Browser) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await browser.next()]


async def test_a_diff_is_sent_as_it_was_encoded_for_all() -> None:
    browser = Browser("anna", "operator", "en")
    one = diff(1, actual="1")
    browser.tell(one)
    assert await browser.next() == [one.text]
    assert json.loads(one.text) == {"is": "diff", "p": 0, "n": 1, "t": 101.0, "f": {"dry/1": {"actual": "1"}}}


async def test_newest_wins_for_a_slow_browser_and_nothing_is_queued() -> None:
    browser = Browser("anna", "operator", "en")
    for n in range(1, 1001):
        browser.tell(diff(n, actual=str(n)))
    browser.tell(diff(1001, mode="local"))
    (only,) = await told(browser)
    assert only["f"] == {"dry/1": {"actual": "1000", "mode": "local"}}
    assert (only["p"], only["n"], only["t"]) == (0, 1001, 1101.0)


async def test_a_merged_diff_leaves_the_shared_one_as_it_was() -> None:
    browser = Browser("anna", "operator", "en")
    first = diff(1, actual="1")
    browser.tell(first)
    browser.tell(diff(2, actual="2"))
    assert first.groups == {"dry/1": {"actual": "1"}}


async def test_all_who_missed_the_same_get_the_same_text() -> None:
    one, other = Browser("anna", "operator", "en"), Browser("bernd", "viewer", "en")
    for each in [diff(n, actual=str(n)) for n in range(1, 500)]:
        one.tell(each)
        other.tell(each)
    assert (await one.next())[0] is (await other.next())[0]


async def test_a_snapshot_makes_what_was_pending_worthless() -> None:
    browser = Browser("anna", "operator", "en")
    browser.tell(diff(1, actual="1"))
    browser.say({"is": "snapshot", "n": 1})
    browser.tell(diff(2, actual="2"))
    assert [(message["is"], message["n"]) for message in await told(browser)] == [
        ("snapshot", 1),
        ("diff", 2),
    ]


async def test_frames_are_bounded() -> None:
    browser = Browser("anna", "operator", "en")
    browser.show_frames([{"hex": str(n)} for n in range(MOST_FRAMES + 50)])
    (message,) = await told(browser)
    assert len(message["frames"]) == MOST_FRAMES
    assert message["frames"][0] == {"hex": "50"}


def flow() -> tuple[Flow, list[float]]:
    now = [100.0]
    return Flow(lambda: now[0]), now


def test_what_one_wire_brings_is_never_held_up() -> None:
    made, now = flow()
    for _ in range(200):
        now[0] += 1 / 38.4
        made.came()
        assert made.pause_s() == 0.0


def test_a_flood_is_told_once_in_a_window_until_it_is_over() -> None:
    made, now = flow()
    made.came(FLOOD + 1)
    assert made.pause_s() == 0.0, "a burst is told at once"
    made.told()
    assert made.pause_s() == WINDOW_S, "and what follows it later"
    now[0] += WINDOW_S
    made.came()
    made.told()
    assert made.pause_s() == WINDOW_S, "the next window begins flooded"
    now[0] += WINDOW_S
    made.came()
    made.told()
    assert made.pause_s() == 0.0, "that window was quiet"


def test_very_many_pages_share_what_the_server_can_send() -> None:
    made, now = flow()
    browser = Browser("anna", "operator", "en", _flow=made)
    browser.share(200)
    made.came()
    assert made.pause_s() == 0.0, "the first is told at once"
    made.told()
    made.came()
    assert made.pause_s() == pytest.approx(200 / MOST_TOLD_S)
    now[0] += 1.01 * 200 / MOST_TOLD_S
    assert made.pause_s() == 0.0


def test_a_few_pages_are_told_of_every_answer() -> None:
    made, _now = flow()
    browser = Browser("anna", "operator", "en", _flow=made)
    browser.share(200)
    browser.share(FEW_PAGES)
    made.told()
    made.came()
    assert made.pause_s() == 0.0
