"""A unit outside the window may be a second old; a visible one never is."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpensPages

PHONE = {"width": 360, "height": 600}
LAST = "line/8"
SHOW = """async (texts) => {
  const { show, draw } = await import(document.querySelector('link[href$="/bind.js"]').href);
  for (const text of texts) {
    show({ "line/1": { actual: text }, "line/8": { actual: text } });
    draw();
  }
  const read = (unit) => document.querySelector(`[data-live="${unit}.actual"]`).textContent.trim();
  return [read("line/1"), read("line/8")];
}"""
KNOWN_TO_BE_HIDDEN = """async () =>
  (await import(document.querySelector('link[href$="/visibility.js"]').href)).mayWait("line/8")"""
LAST_TEXT_IN_THE_FRAME = """(act) => new Promise((resolve) => {
  act();
  requestAnimationFrame(
    () => resolve(document.querySelector('[data-live="line/8.actual"]').textContent.trim()),
  );
})"""
SCROLLED = f"({LAST_TEXT_IN_THE_FRAME})(() => scrollTo(0, document.documentElement.scrollHeight))"
PRINTED = f"({LAST_TEXT_IN_THE_FRAME})(() => dispatchEvent(new Event('beforeprint')))"


def opened(page: Page) -> Page:
    """Return a page of eight tiles on a phone, of which the last is far below the window and known to be. No
    message of the server can come between the steps of a test.
    """
    page.route_web_socket("**/live?*", lambda _browser: None)
    page.goto("/?view=tiles")
    page.wait_for_function(KNOWN_TO_BE_HIDDEN)
    return page


def show_two(page: Page, *texts: str) -> None:
    """Apply two changes of the first and the last unit; the second of the last, outside the window, is not
    drawn yet.
    """
    first, last = page.evaluate(SHOW, texts)
    assert first == texts[1]
    assert last != texts[1]


@pytest.mark.soak
def test_a_unit_outside_the_window_is_drawn_within_a_second_and_at_once_on_paper_and_in_view(
    browser_page: OpensPages,
) -> None:
    page = opened(browser_page("viewer", viewport=PHONE))
    show_two(page, "11.1", "22.2")
    expect(page.locator(f'[data-live="{LAST}.actual"]')).to_contain_text("22.2")
    show_two(page, "33.3", "44.4")
    assert page.evaluate(PRINTED) == "44.4"
    show_two(page, "55.5", "66.6")
    assert page.evaluate(SCROLLED) == "66.6"
