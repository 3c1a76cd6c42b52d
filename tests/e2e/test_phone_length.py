"""No page is longer than twelve screens of a phone, with a day of records of twelve units in the store."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest
from playwright.sync_api import expect

from app.cli.past import write_past
from app.settings import load
from bus.simulator.demo import demo_line
from tests.e2e.conftest import OpensPages
from tests.e2e.site import Site

UNITS, MAX_SCREENS = 12, 12
PHONE = {"width": 360, "height": 800}
SCREENS = "document.documentElement.scrollHeight / innerHeight"


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Twelve units with the past of the demo."""
    made = line_server(UNITS)
    made.stop()
    # The browser's event loop runs in this thread.
    with ThreadPoolExecutor(1) as threads:
        threads.submit(write_past, load(made.config), demo_line(UNITS)).result()
    made.start()
    made.wait_for_units()
    return made


@pytest.mark.soak
@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/?view=rows",
        "/units/line/1",
        "/units/line/1/parameters",
        "/units/line/1/restore",
        "/setpoints",
        "/batch/line",
        "/bus/line",
        "/trends",
        "/alarms",
        "/alarms/journal",
        "/alarms/performance",
        "/alarms/own",
        "/events",
        "/shifts",
        "/shifts/present",
        "/sets",
        "/sets/1",
        "/sets/compare?left=golden:line:1&right=live:line:1",
        "/recipes",
        "/recipes/1",
        "/notifications",
        "/account",
    ],
)
def test_no_page_is_longer_than_twelve_screens_of_a_phone(
    site: Site, shared_page: OpensPages, path: str
) -> None:
    page = shared_page("engineer", site=site, viewport=PHONE)
    response = page.goto(path)
    assert response is not None
    assert response.ok
    expect(page.locator("h1").first).to_be_attached()
    assert page.evaluate(SCREENS) <= MAX_SCREENS
