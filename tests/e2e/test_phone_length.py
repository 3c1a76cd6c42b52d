"""No page is longer than twelve screens of a phone, with a day of records of twelve units in the store."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import OpensPages
from tests.e2e.site import Site

MAX_SCREENS = 12
PHONE = {"width": 360, "height": 800}
SCREENS = "document.documentElement.scrollHeight / innerHeight"
PATHS = [
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
    "/reports",
    "/sets",
    "/sets/1",
    "/sets/compare?left=golden:line:1&right=live:line:1",
    "/recipes",
    "/recipes/1",
    "/notifications",
    "/configuration",
    "/configuration/tables/bus.0.unit.0",
    "/account",
    "/system",
]


@pytest.mark.soak
@pytest.mark.parametrize("path", PATHS)
def test_no_page_is_longer_than_twelve_screens_of_a_phone(
    past_site: Site, shared_page: OpensPages, path: str
) -> None:
    page = shared_page("engineer", site=past_site, viewport=PHONE)
    response = page.goto(path)
    assert response is not None
    assert response.ok
    expect(page.locator("h1").first).to_be_attached()
    assert page.evaluate(SCREENS) <= MAX_SCREENS
