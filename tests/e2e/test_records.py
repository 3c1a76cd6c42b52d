"""The pages of what was recorded, with a full page of records and with long names, on a phone. 20 s."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import TOO_WIDE, OpensPages
from tests.e2e.site import AT_REST, Site, eventually

PHONE = {"width": 360, "height": 800}
MAX_SCREENS = 12
ON_A_PAGE = 100
WORD = "W" * 80
UNIT = 2


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Three units with a hundred events, as many transitions of alarms, and names of one long word."""
    made = line_server(3, line_options=AT_REST)
    made.line.remote.do("input", unit=UNIT, input="estop", on=True)

    def alarm() -> dict[str, Any] | None:
        found = client.get("/alarms").json()["alarms"]
        return next((each for each in found if each["code"] == "estop_active"), None)

    with made.api("admin") as client:
        named: dict[str, Any] = {"name": WORD, "comment": WORD}
        recipe = named | {"setpoints": {"1": 700}}
        # Once the ranges of setpoints are read.
        eventually(lambda: client.post("/buses/line/recipes", json=recipe).is_success, "a recipe")
        client.post("/buses/line/sets", json=named).raise_for_status()
        key = eventually(alarm, "an alarm")["id"]
        for _ in range(ON_A_PAGE // 2):
            client.post(f"/alarms/{key}/out-of-service", json={"reason": "Limit switch"}).raise_for_status()
            client.post(f"/alarms/{key}/in-service", json={}).raise_for_status()
    return made


@pytest.mark.soak
@pytest.mark.parametrize("path", ["/events", "/alarms/journal", "/alarms", "/shifts", "/shifts/present"])
def test_a_page_full_of_records_is_not_endless(shared_page: OpensPages, path: str) -> None:
    page = shared_page("admin", viewport=PHONE)
    page.goto(path)
    expect(page.locator("body[data-link=live]")).to_be_attached()
    if path in ("/events", "/alarms/journal"):
        assert page.locator("tbody > tr").count() == ON_A_PAGE
    assert page.evaluate("document.documentElement.scrollHeight / innerHeight") <= MAX_SCREENS


@pytest.mark.soak
@pytest.mark.parametrize("path", ["/recipes/1", "/sets", "/sets/1", "/recipes", "/trends"])
def test_a_long_word_widens_no_page(shared_page: OpensPages, path: str) -> None:
    page = shared_page("admin", viewport=PHONE)
    form = {"name": WORD, "query": "s=line/1/actual"}
    page.goto(path)
    if path == "/trends":
        origin = page.url.partition("/trends")[0]
        page.request.post("/trends/views", form=form, headers={"Origin": origin})
        page.reload()
        page.locator("#trend-views").evaluate("views => { views.open = true }")
    expect(page.get_by_text(WORD).first).to_be_attached()
    assert not page.evaluate(TOO_WIDE)
