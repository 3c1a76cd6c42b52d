"""One clock on every page: the server's time in the server's zone, whatever clock and zone the device has."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, time, timedelta
from urllib.parse import parse_qs, urlsplit
from zoneinfo import ZoneInfo

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import OpensPages
from tests.e2e.pages import opened
from tests.e2e.site import AT_REST, Site
from tests.e2e.site import site as one_site

SERVER, DEVICE = ZoneInfo("Asia/Kolkata"), "America/New_York"
NEAR = timedelta(minutes=15)
"""Less than any two zones differ by, more than a busy machine takes for a page."""
HOUR_AHEAD = """
const real = Date.now;
Date.now = () => real() + 3600_000;
"""
OLD_BROWSER = """
const Real = Intl.DateTimeFormat;
Intl.DateTimeFormat = function (language, options) {
  if (options?.timeZone === "Asia/Kolkata") throw new RangeError("Invalid time zone specified");
  return new Real(language, options);
};
"""


@pytest.fixture(scope="module")
def far_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A site that names no zone, on a machine in India."""
    folder = tmp_path_factory.mktemp("far")
    with one_site(folder, 2, line_options=AT_REST, environment={"TZ": "Asia/Kolkata"}) as made:
        yield made


def is_now_there(shown: time) -> bool:
    """Whether a time of day is about now where the server is."""
    now = datetime.now(SERVER).replace(tzinfo=None)
    apart = abs(datetime.combine(now.date(), shown) - now)
    return min(apart, timedelta(days=1) - apart) < NEAR


def test_scripts_and_pages_show_the_zone_of_the_server(far_site: Site, browser_page: OpensPages) -> None:
    page = opened(browser_page("engineer", far_site, timezone_id=DEVICE), "/events")
    clock = page.locator("[data-clock]")
    assert is_now_there(time.fromisoformat(clock.inner_text()))
    expect(clock).to_have_attribute("title", "Asia/Kolkata")
    written = page.locator("tbody time").first
    assert written.get_attribute("datetime", timeout=0)[-6:] == "+05:30"  # type: ignore[index]
    opened(page, "/bus/line")
    page.locator("[data-trace]").click()
    expect(page.locator(".frames__line").first).to_be_visible()
    assert is_now_there(time.fromisoformat(page.locator(".frames__line span").first.inner_text()[:8]))
    opened(page, "/trends")
    expect(page.locator("#trends[data-drawn]")).to_be_attached()
    # A browser leaves seconds that are zero out of the value of a field.
    to = datetime.fromisoformat(page.locator("#trend-exact [name=to]").input_value())
    assert is_now_there(to.time())


@pytest.mark.soak
def test_charts_end_at_the_servers_now(far_site: Site, browser_page: OpensPages) -> None:
    page = browser_page("viewer", far_site)
    page.add_init_script(HOUR_AHEAD)
    with page.expect_request("**/sparks?**") as expected:
        page.goto("/units/line/1")
    ends = parse_qs(urlsplit(expected.value.url).query)["to"][0]
    assert abs(datetime.fromisoformat(ends) - datetime.now(SERVER)) < NEAR


@pytest.mark.soak
def test_a_browser_that_does_not_know_the_zone_shows_utc_with_a_notice(
    far_site: Site, browser_page: OpensPages
) -> None:
    page = browser_page("viewer", far_site, timezone_id=DEVICE)
    page.add_init_script(OLD_BROWSER)
    opened(page, "/events")
    expect(page.locator("[data-clock]")).to_contain_text(" UTC")
