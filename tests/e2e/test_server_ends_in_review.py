"""The server is killed while a review is open: nothing is sent, then or later, and the page states that."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.pages import PANEL
from tests.e2e.site import AT_REST, Site, eventually
from tests.e2e.test_setting import opened, state


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Three units and a recipe for them."""
    made = line_server(3, line_options=AT_REST)
    with made.api("engineer") as client:
        eventually(
            lambda: client.post("/buses/line/recipes", json={"name": "Sixty gram"}).status_code == 201,
            "a recipe of setpoints that have been read",
        )
    return made


def review_speed(page: Page) -> None:
    opened(page, "/units/line/1").locator("#setpoint").fill("61.0")
    page.get_by_role("button", name="Set now").click()


def review_group(page: Page) -> None:
    opened(page, "/setpoints").locator(".setpoints__new[name=new-1]").fill("61.0")
    page.get_by_role("button", name="Review the change").click()


def review_recipe(page: Page) -> None:
    opened(page, "/recipes/1").get_by_role("button", name="Load Sixty gram").click()


@pytest.mark.soak
@pytest.mark.provokes("WebSocket connection", "Failed to fetch")
@pytest.mark.parametrize(
    ("review", "field"),
    [(review_speed, "#setpoint"), (review_group, ".setpoints__new[name=new-1]"), (review_recipe, "")],
)
def test_a_server_that_ends_in_a_review_sends_nothing(
    site: Site, browser_page: OpensPages, review: Callable[[Page], None], field: str
) -> None:
    page = browser_page("engineer", viewport=PANEL)
    before = site.writes()
    review(page)
    expect(page.locator("[data-review-act]")).to_be_visible()
    site.stop(signal.SIGKILL)
    expect(page.locator("body[data-link=lost]")).to_be_attached()
    expect(page.locator("#gone-title")).to_be_visible()
    expect(page.locator("[data-review-act]:visible")).to_have_count(0)
    page.keyboard.press("Enter")
    site.start()
    site.wait_for_units()
    expect(page.locator("body[data-link=live]")).to_be_attached()
    ended = page.locator("[data-review-end]")
    expect(ended).to_contain_text("The connection to the server was lost during the review. Nothing")
    expect(ended).to_be_in_viewport(ratio=1)
    expect(page.locator("[data-review-act]")).to_have_count(0)
    assert site.writes() == before
    if not field:
        return
    if page.locator("dialog[open]").count():
        page.get_by_role("button", name="Close").click()
    expect(page.locator(field)).to_have_value("61.0")
    page.get_by_role("button", name=re.compile("Set now|Review the change")).click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_be_visible()
    assert state(site, 1)["setpoint"] == 610
