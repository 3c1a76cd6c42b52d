"""A first visit without a cache: what a page weighs, and how long until it is live and responds to a
click.
"""

from __future__ import annotations

from playwright.sync_api import Browser, Page, Request

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
    header = [
        "first visit of",
        "requests",
        "on the way",
        "without the font",
        "live",
        "a press has opened its review",
    ]
    note = f"Median of {VISITS} browsers without a cache; below 1 s, 160 kB, and 95 kB without the font."
    show("What a page weighs, and how soon it can be used", header, rows, note)


def _row(served: Site, chromium: Browser, path: str, presses: str) -> list[str]:
    visits = [_visit(served, chromium, path, presses) for _ in range(VISITS)]
    requests, *weights = visits[0][:3]
    times = [median([visit[place] for visit in visits]) for place in (3, 4)]
    return [
        f"{requests:.0f}",
        *(f"{weight / 1000:.0f} kB" for weight in weights),
        *(f"{time:.0f} ms" for time in times),
    ]


def _visit(served: Site, chromium: Browser, path: str, presses: str) -> tuple[float, ...]:
    """(requests, bytes, bytes without the font, ms until live, until the review is open) of one visit."""
    context = chromium.new_context(base_url=served.url, storage_state=signed_in(chromium, served, "operator"))
    page = context.new_page()
    finished: list[Request] = []
    page.on("requestfinished", lambda request: finished.append(request))
    page.add_init_script(f"({PRESS_WHEN_LIVE})({presses!r})")
    page.goto(path)
    page.wait_for_selector("[data-review-act]")
    page.wait_for_load_state("networkidle")
    live, opened = _times(page)
    weights = {request.url: _weight(request) for request in finished}
    font = sum(weight for url, weight in weights.items() if url.endswith(".woff2"))
    context.close()
    return len(finished), sum(weights.values()), sum(weights.values()) - font, live, opened


def _weight(request: Request) -> int:
    size = request.sizes()
    return size["responseBodySize"] + size["responseHeadersSize"]


def _times(page: Page) -> tuple[float, float]:
    live, opened = page.evaluate("[window.live_at, window.open_at]")
    return live, opened
