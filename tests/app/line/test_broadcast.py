from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from app.line.live.browser import Browser, Diff
from app.line.live.hub import FEW_PAGES, Broadcast
from tests.app.screens import line, screen

GROUP = "dry/1"


def broadcast() -> Broadcast:
    return Broadcast(screen(line()), lambda: 100.0)


async def sent(browser: Browser) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await browser.next()]


def joined(made: Broadcast) -> Browser:
    browser = Browser("anna", "operator", "en")
    made.join(browser)
    return browser


async def test_a_snapshot_states_what_a_page_is_rendered_with() -> None:
    made = Broadcast(screen(line()), lambda: 100.0, "3f9a")
    (snapshot,) = await sent(joined(made))
    assert snapshot["digest"] == "3f9a"


async def test_few_pages_are_updated_at_once() -> None:
    made = broadcast()
    browser = joined(made)
    made.publish({GROUP: {"actual": "1"}})
    made.publish({GROUP: {"actual": "2"}})
    assert made.number == 2
    snapshot, diff = await sent(browser)
    assert (snapshot["n"], diff["p"], diff["n"], diff["f"]) == (0, 0, 2, {GROUP: {"actual": "2"}})


async def test_among_very_many_delayed_changes_go_as_one() -> None:
    made = broadcast()
    made.flow.share(FEW_PAGES + 1)
    browser = joined(made)
    made.publish({GROUP: {"actual": "1"}})
    await sent(browser)
    made.publish({GROUP: {"actual": "2", "mode": "local"}})
    made.publish({GROUP: {"actual": "3"}})
    assert made.number == 1
    async with asyncio.timeout(30):
        (diff,) = await sent(browser)
    assert (diff["p"], diff["n"], diff["f"]) == (1, 2, {GROUP: {"actual": "3", "mode": "local"}})


async def test_a_page_that_opens_meanwhile_misses_no_number() -> None:
    made = broadcast()
    made.flow.share(FEW_PAGES + 1)
    joined(made)
    made.publish({GROUP: {"actual": "1"}})
    made.publish({GROUP: {"actual": "2"}})
    late = joined(made)
    ((snapshot,), (diff,)) = (await sent(late), await sent(late))
    assert (snapshot["n"], diff["p"]) == (1, 1)


async def test_nothing_is_kept_without_pages() -> None:
    made = broadcast()
    made.flow.share(FEW_PAGES + 1)
    browser = joined(made)
    made.publish({GROUP: {"actual": "1"}})
    made.publish({GROUP: {"actual": "2"}})
    made.leave(browser)
    made.publish({GROUP: {"actual": "3"}}, always=True)
    assert made.number == 1
    await sent(joined(made))
    made.flow.share(1)
    made.publish({}, always=True)
    assert made.number == 2


@pytest.mark.parametrize(("always", "number"), [(False, 0), (True, 1)])
async def test_without_changes_only_a_heartbeat_is_sent(always: bool, number: int) -> None:
    made = broadcast()
    joined(made)
    made.publish({}, always=always)
    assert made.number == number


async def test_no_reader_is_always_the_last() -> None:
    made, order = broadcast(), list[str]()

    class Noting(Browser):
        def send_diff(self, diff: Diff) -> None:
            order.append(self.name)
            super().send_diff(diff)

    for name in "abc":
        made.join(Noting(name, "operator", "en"))
    for n in range(3):
        made.publish({GROUP: {"actual": str(n)}})
    assert {order[n : n + 3][-1] for n in (0, 3, 6)} == {"a", "b", "c"}
