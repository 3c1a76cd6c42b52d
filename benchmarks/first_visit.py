"""A first visit without a cache: what a page weighs, and how long until it is live and responds to a
click.
"""

from __future__ import annotations

from typing import Any

from playwright.sync_api import Browser, Page

from benchmarks.tables import median, show
from tests.e2e.conftest import signed_in
from tests.e2e.site import Site

VISITS = 5
PAGES = {"the line page": ("/", ".zero"), "a unit's page": ("/units/line/1", "button[value=now]")}
"""The page opened, and the control clicked as soon as the page is live: each opens a review."""
PRESS_WHEN_LIVE = """selector => {
  const body = () => document.body?.dataset.link === 'live';
  new MutationObserver(() => {
    if (!window.live_at && body()) {
      window.live_at = performance.now();
      document.querySelector(selector).click();
    }
    if (!window.open_at && document.querySelector('[data-review-act]')) {
      window.open_at = performance.now();
    }
  }).observe(document, { attributes: true, childList: true, subtree: true });
}"""


def show_first_visit(served: Site, chromium: Browser) -> None:
    """A table of the two pages that an operator works on."""
    rows = [[name, *_row(served, chromium, *page)] for name, page in PAGES.items()]
    header = ["first visit of", "requests", "on the way", "live", "a press has opened its review"]
    note = f"From the first request, the median of {VISITS} browsers without a cache; below 1 s and 160 KiB."
    show("What a page weighs, and how soon it can be used", header, rows, note)


def _row(served: Site, chromium: Browser, path: str, presses: str) -> list[str]:
    visits = [_visit(served, chromium, path, presses) for _ in range(VISITS)]
    requests, weight = visits[0][:2]
    live, opened = (median([visit[place] for visit in visits]) for place in (2, 3))
    return [f"{requests:.0f}", f"{weight / 1024:.0f} KiB", f"{live:.0f} ms", f"{opened:.0f} ms"]


def _visit(served: Site, chromium: Browser, path: str, presses: str) -> tuple[float, float, float, float]:
    """(requests, bytes on the way, ms until live, ms until the review is open) of one new browser."""
    context = chromium.new_context(base_url=served.url, storage_state=signed_in(chromium, served, "operator"))
    page = context.new_page()
    finished: list[Any] = []
    page.on("requestfinished", lambda request: finished.append(request))
    page.add_init_script(f"({PRESS_WHEN_LIVE})({presses!r})")
    page.goto(path)
    page.wait_for_selector("[data-review-act]")
    page.wait_for_load_state("networkidle")
    live, opened = _times(page)
    sizes = [request.sizes() for request in finished]
    weight = sum(size["responseBodySize"] + size["responseHeadersSize"] for size in sizes)
    context.close()
    return len(sizes), weight, live, opened


def _times(page: Page) -> tuple[float, float]:
    live, opened = page.evaluate("[window.live_at, window.open_at]")
    return live, opened
