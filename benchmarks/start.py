"""The start: from nothing running to the first live value, in the browser."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, Error, Page, sync_playwright

from benchmarks.tables import median, show
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in
from tests.e2e.site import Site, site

STARTS = 5
FIRST_VALUE = """() => {
  const shown = document.querySelector('[data-live="line/1.actual"]');
  return document.body.dataset.link === 'live' && shown !== null && /[0-9]/.test(shown.textContent);
}"""


def run() -> None:
    """One table."""
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), 8, installed=True) as served,
        sync_playwright() as playwright,
    ):
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        signed_in(chromium, served, "viewer")
        times = [_start(served, chromium) for _ in range(STARTS)]
        chromium.close()
    names = ["it responds", "the first live value is on the page", "after SIGTERM all has ended"]
    rows = [
        [name, f"{median(column):.2f} s", f"{max(column):.2f} s"]
        for name, column in zip(names, zip(*times, strict=True), strict=True)
    ]
    show(f"{STARTS} starts of `lineside serve`, 8 units", ["until", "median", "worst"], rows)


def _start(served: Site, chromium: Browser) -> tuple[float, float, float]:
    begun = time.monotonic()
    served.stop()
    ended = time.monotonic() - begun
    page = chromium.new_context(base_url=served.url, storage_state=served.sessions["viewer"]).new_page()
    begun = time.monotonic()
    served.start()
    ready = time.monotonic() - begun
    _open(page)
    page.wait_for_function(FIRST_VALUE)
    shown = time.monotonic() - begun
    page.context.close()
    return ready, shown, ended


def _open(page: Page) -> None:
    while True:
        try:
            page.goto("/")
        except Error:
            continue
        return
