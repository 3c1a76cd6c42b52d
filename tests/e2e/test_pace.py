"""Drawing keeps to its share of the main thread, and a quick device waits for nothing; on a clock of the
test's own."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from playwright.sync_api import Page

from tests.e2e.conftest import OpensPages

pytestmark = pytest.mark.soak

RUN_MS = 20_000
MOST = 0.25
"""Of the main thread."""
LONGEST_MS = 600
# The module once more, on a device whose time passes by what is done on it: so many ms to write, so many to
# lay out and paint. Something new is told every `every` ms. Of each drawing: its begin, and how long it
# waited.
DEVICE = """async ([write, frame, every, run]) => {
  let now = 0;
  let timers = [];
  let frames = [];
  const delivered = () => new Promise((heard) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => { port1.close(); heard(); };
    port2.postMessage(0);
  });
  const real = [performance.now, window.setTimeout, window.requestAnimationFrame];
  performance.now = () => now;
  window.setTimeout = (act, wait, ...rest) => timers.push({ at: now + wait, act: () => act(...rest) });
  window.requestAnimationFrame = (act) => frames.push(act);
  const { soon } = await import(document.querySelector('link[href$="/pace.js"]').href + "?of-a-test");
  const drawn = [];
  let told = null;
  const draw = () => {
    drawn.push([now, told === null ? 0 : now - told]);
    told = null;
    now += write;
    return write > 0;
  };
  for (let next = 0; now < run;) {
    if (now >= next) {
      next = Math.max(next + every, now);
      told ??= now;
      soon(draw);
    }
    const due = timers.filter(({ at }) => at <= now);
    timers = timers.filter(({ at }) => at > now);
    for (const { act } of due) act();
    const asked = frames;
    frames = [];
    for (const act of asked) act();
    if (asked.length) {
      now += frame;
      await delivered();
    }
    now += 1;
  }
  [performance.now, window.setTimeout, window.requestAnimationFrame] = real;
  return drawn;
}"""
PACE = """async ([name, args]) =>
  (await import(document.querySelector('link[href$="/pace.js"]').href))[name](...args)"""


@pytest.fixture
def page(browser_page: OpensPages) -> Page:
    """A page that has the module and draws nothing by itself, so that the clock is the test's alone."""
    opened = browser_page(None)
    opened.goto("/login")
    return opened


def device(page: Page, write: float, frame: float, every: float) -> list[list[float]]:
    """Each drawing: when it began, and how long what it drew had waited."""
    drawn: list[list[float]] = page.evaluate(DEVICE, [write, frame, every, RUN_MS])
    return drawn


def pace(page: Page, name: str, *args: Any) -> float:
    """What a function of the module answers."""
    answer: float = page.evaluate(PACE, [name, args])
    return answer


@pytest.mark.parametrize(("write", "frame"), [(3, 7), (10, 30), (20, 80)])
def test_a_slow_device_draws_within_the_share(page: Page, write: float, frame: float) -> None:
    drawn = device(page, write, frame, 10)
    assert len(drawn) * (write + frame) <= MOST * RUN_MS
    assert len(drawn) * (write + frame) >= 0.5 * MOST * RUN_MS, "it may draw more than that"


def test_a_quick_device_draws_at_once_what_it_is_told(page: Page) -> None:
    drawn = device(page, 1, 2, 26)
    assert len(drawn) >= RUN_MS / 26 - 1
    assert max(waited for _, waited in drawn) == 0


def test_of_what_nobody_can_see_there_is_nothing_to_pay_for(page: Page) -> None:
    drawn = device(page, 0, 80, 10)
    assert max(waited for _, waited in drawn) == 0


def test_nothing_waits_for_long_on_the_slowest_device(page: Page) -> None:
    cost = 400
    drawn = device(page, 100, 300, 10)
    starts = [began for began, _ in drawn]
    apart = [later - earlier for earlier, later in pairwise(starts)]
    assert max(apart) <= max(LONGEST_MS, cost) + 10


def test_what_came_in_between_once_is_no_cost_of_drawing(page: Page) -> None:
    assert pace(page, "credible", [4, 6, 5, 7]) == 7
    assert pace(page, "credible", [4, 6, 5, 900]) == 8
    assert pace(page, "credible", [900, 900, 900, 4]) == 4
    assert pace(page, "credible", [900]) == 0


def test_a_few_cheap_drawings_in_a_row_wait_for_nothing_but_many_do(page: Page) -> None:
    began, cost, until = 1_000_000, 3, 0.0
    ready = []
    for _ in range(30):
        until = pace(page, "usedUp", until, began, cost)
        ready.append(pace(page, "readyAt", until) <= began)
    assert ready[:3] == [True, True, True], "also after a long rest"
    assert not ready[-1]
