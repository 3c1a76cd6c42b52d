"""A second tap within a second on a button that acts does nothing. The time of the page is the test's."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.site import Site, eventually

CLOCK = """const real = Date.now;
Date.now = () => Number(sessionStorage.getItem("test-now") ?? real());"""
UNIT = 7


@pytest.fixture
def page(site: Site, browser_page: OpensPages) -> Page:
    """The page of a unit, on which no time passes."""
    site.set_speed(UNIT, value="100.0")
    opened = browser_page(viewport={"width": 1280, "height": 800}, taps=True)
    opened.add_init_script(CLOCK)
    opened.goto(f"{site.url}/units/line/{UNIT}")
    expect(opened.locator("body[data-link=live]")).to_be_attached()
    expect(opened.locator("#setpoint")).to_have_value("100.0")
    opened.evaluate("sessionStorage.setItem('test-now', Date.now())")
    return opened


@pytest.fixture
def step(page: Page) -> Locator:
    return page.get_by_role("button", name="Up by 0.2")


def let_pass(page: Page, ms: int) -> None:
    # A press is dropped while the response to the one before is on its way.
    expect(page.locator(".htmx-request")).to_have_count(0)
    page.evaluate("ms => sessionStorage.setItem('test-now', Date.now() + ms)", ms)


def commanded(site: Site) -> str:
    found: str = site.unit(UNIT)["commanded"]
    return found


def test_a_second_tap_on_a_button_changes_nothing(site: Site, page: Page, step: Locator) -> None:
    step.click()
    expect(page.locator("#setpoint")).to_have_value("100.2")
    let_pass(page, 999)
    step.click()
    let_pass(page, 1)
    step.click()
    expect(page.locator("#setpoint")).to_have_value("100.4")
    eventually(lambda: commanded(site) == "100.4", "two steps of three presses")


def test_a_second_press_of_a_key_changes_nothing(site: Site, page: Page, step: Locator) -> None:
    step.press("Enter")
    expect(page.locator("#setpoint")).to_have_value("100.2")
    step.press("Enter")
    let_pass(page, 1000)
    step.press("Enter")
    expect(page.locator("#setpoint")).to_have_value("100.4")
    eventually(lambda: commanded(site) == "100.4", "two steps of three presses")


def test_a_second_tap_does_not_confirm_what_the_first_one_opened(site: Site, page: Page) -> None:
    page.locator("#setpoint").fill("110.0")
    page.get_by_role("button", name="Set now").click()
    act = page.locator("[data-review-act]")
    expect(act).to_be_visible()
    place = page.get_by_role("button", name="Set now", include_hidden=True).bounding_box()
    assert place is not None
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    act.evaluate(
        """(act, [x, y]) => {
            const { left, top, width, height } = act.getBoundingClientRect();
            act.style.translate = `${x - left - width / 2}px ${y - top - height / 2}px`;
        }""",
        [x, y],
    )
    page.mouse.click(x, y)
    expect(act).to_be_visible()
    expect(page.locator("[data-pending]")).to_have_count(0)
    let_pass(page, 1000)
    page.mouse.click(x, y)
    expect(page.locator("[data-review-done=good]")).to_be_visible()
    assert commanded(site) == "110.0"


def test_a_second_tap_does_nothing_on_a_button_that_was_drawn_in_place_of_the_first(page: Page) -> None:
    """As the legend of a trend is, whose button is another one after each press."""
    page.evaluate(
        """() => {
            const box = document.createElement("div");
            box.style.cssText = "position: fixed; z-index: 99; left: 100px; top: 100px";
            box.id = "redrawn";
            const draw = (presses) => {
                const button = document.createElement("button");
                button.type = "button";
                button.textContent = presses;
                button.addEventListener("click", () => draw(presses + 1));
                box.replaceChildren(button);
            };
            draw(0);
            document.body.append(box);
        }"""
    )
    redrawn = page.locator("#redrawn")
    redrawn.dblclick(delay=5)
    expect(redrawn).to_have_text("1")
    let_pass(page, 1000)
    redrawn.click()
    expect(redrawn).to_have_text("2")


def test_the_same_digit_is_typed_twice(page: Page) -> None:
    digit = page.locator("[data-pad='7']")
    digit.click()
    digit.click()
    expect(page.locator("#setpoint")).to_have_value("77")


@pytest.fixture
def stopped(site: Site) -> Iterator[str]:
    """The id of an alarm to acknowledge."""
    site.line.remote.do("input", unit=UNIT, input="estop", on=True)
    with site.api() as client:
        query = {"unit": UNIT, "state": "unack_active"}

        def found() -> list[str]:
            alarms = client.get("/alarms", params=query).json()["alarms"]
            return [alarm["id"] for alarm in alarms if alarm["code"] == "estop_active"]

        yield eventually(found, "an alarm")[0]
        site.line.remote.do("input", unit=UNIT, input="estop", on=False)
        eventually(
            lambda: client.get("/alarms", params=query | {"state": "normal"}).json()["alarms"], "normal"
        )


@pytest.mark.soak
def test_a_second_tap_presses_nothing_on_the_page_that_the_first_one_opened(
    site: Site, page: Page, stopped: str
) -> None:
    page.goto(f"{site.url}/alarms/{stopped}")
    place = page.locator("main").get_by_role("button", name="Acknowledge alarm").bounding_box()
    assert place is not None
    x, y = place["x"] + 20, place["y"] + 20
    page.mouse.click(x, y)
    expect(page).to_have_url(re.compile(r"/alarms(\?.*)?$"))
    page.evaluate(
        """([x, y]) => {
            const button = document.createElement("button");
            button.style.cssText = `position: fixed; z-index: 99; left: ${x - 50}px; top: ${y - 50}px;
                width: 100px; height: 100px`;
            button.addEventListener("click", () => (button.dataset.pressed = ""));
            button.id = "under-the-finger";
            document.body.append(button);
        }""",
        [x, y],
    )
    under = page.locator("#under-the-finger")
    page.mouse.click(x, y)
    expect(under).not_to_have_attribute("data-pressed", "")
    let_pass(page, 1000)
    page.mouse.click(x, y)
    expect(under).to_have_attribute("data-pressed", "")
