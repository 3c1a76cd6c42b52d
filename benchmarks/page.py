"""A viewer's page in Chromium, for measurements."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import CDPSession, Page, sync_playwright

from benchmarks.fed import fed_site
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in
from tests.e2e.site import Site


@contextmanager
def viewer_page(served: Site, role: str = "viewer") -> Iterator[Page]:
    """Signed in, and nothing opened yet."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        session = signed_in(chromium, served, role)
        yield chromium.new_context(base_url=served.url, storage_state=session).new_page()
        chromium.close()


@contextmanager
def fed_page(units: int, rate: float, what: str = "") -> Iterator[tuple[Page, CDPSession]]:
    """The line page, live, of as many units that all change ``rate`` times a second; and its devtools, which
    count what it does. ``what``: as in :func:`benchmarks.fed.fed_site`."""
    with (
        tempfile.TemporaryDirectory() as folder,
        fed_site(Path(folder), units, rate, what=what) as served,
        viewer_page(served) as page,
    ):
        page.goto("/")
        page.wait_for_selector("body[data-link=live]")
        devtools = page.context.new_cdp_session(page)
        devtools.send("Performance.enable")
        yield page, devtools
