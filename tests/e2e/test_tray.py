"""The change tray as a person uses it: gathered on several pages, reviewed and sent as one change."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import groupby

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages, focus
from tests.e2e.limits import UNIT_MS
from tests.e2e.pages import PANEL, PHONE, opened
from tests.e2e.site import AT_REST, Site, eventually

UNITS = 12


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Twelve units that only the test operates."""
    return line_server(UNITS, line_options=AT_REST)


@pytest.fixture
def page(shared_page: OpensPages) -> Page:
    """The setpoints of the line, of an engineer with an empty tray."""
    page = opened(shared_page("engineer", viewport=PANEL), "/tray")
    empty = page.get_by_role("button", name="Empty the tray")
    if empty.count():
        empty.click()
        expect(page.get_by_text("The change tray is empty")).to_be_visible()
    return page


def writes(site: Site) -> list[int]:
    """The function code of every request that writes; each unit receives a broadcast."""
    return [bytes.fromhex(frame)[1] for frame, _ in groupby(site.writes())]


def strip(page: Page) -> Locator:
    return page.locator("#tray")


def add_setpoint(page: Page, unit: int, value: str) -> None:
    opened(page, f"/units/line/{unit}")
    page.locator("#setpoint").fill(value)
    page.locator(".setter").get_by_role("button", name="Add to tray").click()
    expect(page.locator("#setpoint-error [data-added]")).to_be_visible()


def edges(part: Locator) -> tuple[float, float]:
    """Top and bottom in the window."""
    box = part.bounding_box()
    assert box is not None
    return box["y"], box["y"] + box["height"]


def review(page: Page) -> None:
    strip(page).get_by_role("link", name="Review the tray").click()
    expect(page.locator("[data-review-act]")).to_be_visible(timeout=UNIT_MS)


def send(page: Page) -> None:
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done]")).to_be_visible(timeout=UNIT_MS)


@pytest.fixture
def local(site: Site) -> Iterator[Callable[[int], None]]:
    """Set a unit to LOCAL at its keypad, until the end of the test."""
    units: list[int] = []

    def set_mode(unit: int, mode: str) -> None:
        site.line.remote.do("mode", unit=unit, to=mode)
        eventually(lambda: site.unit(unit)["mode"] == mode.upper(), f"{mode} is seen")

    def set_local(unit: int) -> None:
        units.append(unit)
        set_mode(unit, "local")

    yield set_local
    for unit in units:
        set_mode(unit, "remote")


def test_gathered_on_three_pages_one_unit_left_out_sent_proven_and_undone(
    site: Site, page: Page, local: Callable[[int], None]
) -> None:
    before = {unit: site.unit(unit)["commanded"] for unit in (3, 4)}
    add_setpoint(page, 3, "90.0")
    expect(strip(page)).to_contain_text(re.compile(r"1 change\W+1 unit"))
    page.get_by_role("button", name="Switch output 3").click()
    page.locator("#outputs-review").get_by_role("button", name="Add to tray").click()
    expect(page.locator("#outputs-result [data-added]")).to_be_visible()
    expect(page.locator("[data-review]")).to_have_count(0)

    opened(page, "/units/line/4/parameters")
    page.locator("#parameter-12 input[name=value]").fill("1.5")
    page.locator("#parameter-12").get_by_role("button", name="Write").click()
    page.locator("#review").get_by_role("button", name="Add to tray").click()
    expect(page.locator("#parameter-12-error [data-added]")).to_be_visible()
    expect(page.locator("#review")).to_be_hidden()

    page.set_viewport_size({"width": 640, "height": 400})
    opened(page, "/setpoints")
    page.locator('[name="new-4"]').fill("91.0")
    page.locator('[name="new-5"]').fill("92.0")
    add = page.get_by_role("button", name="Add to tray")
    add.click()
    expect(strip(page)).to_contain_text(re.compile(r"5 changes\W+3 units"))
    expect(page.locator('[name="new-4"]')).to_have_value("")
    expect(page.locator("#change-line > *")).to_be_in_viewport()
    add.click(trial=True)  # the strip lies over neither
    page.set_viewport_size(PANEL)

    opened(page, "/")
    expect(page.locator(".tile [data-in-tray='line/4']")).to_have_text("91.0")
    local(5)
    sent = len(writes(site))
    review(page)
    act = page.locator("[data-review-act]")
    expect(act).to_have_text("Send 4 changes")
    expect(page.locator("#review")).to_contain_text("Dryer 2 not possible: not in REMOTE")
    box = page.get_by_label("Leave out Dryer 2")
    place = box.bounding_box()
    act.click()
    expect(page.locator("[data-review]:not([data-pending])")).to_be_visible()
    expect(page.get_by_text("Not sent: this box is not ticked.")).to_be_in_viewport()
    assert box.bounding_box() == place, "the refusal is below it and moves nothing"
    assert len(writes(site)) == sent, "all of them or none"
    box.check()
    send(page)
    expect(page.locator("[data-review-done=good]")).to_contain_text("4 changes made")
    expect(page.locator("#tray-result")).to_contain_text("left out: not in REMOTE")
    assert writes(site)[sent:] == [0x82, 0x82, 0x83, 0x87, 0x86]
    assert [site.unit(unit)["commanded"] for unit in (3, 4)] == ["90.0", "91.0"]
    expect(strip(page)).to_contain_text(re.compile(r"1 change\W+1 unit"))
    held = [page.locator(f".tile [data-in-tray='line/{unit}']").inner_text() for unit in (4, 5)]
    assert held == ["", "92.0"]

    page.get_by_role("button", name="Undo: set the former setpoints").click()
    page.get_by_role("button", name="Set 2 units now").click()
    expect(page.locator("#tray-result")).not_to_contain_text("4 changes made", timeout=UNIT_MS)
    expect(page.locator("[data-review-done=good]")).to_be_visible(timeout=UNIT_MS)
    assert {unit: site.unit(unit)["commanded"] for unit in before} == before
    with site.api() as client:
        events = client.get("/events", params={"limit": 20, "kind": "command"}).json()["events"]
    assert sum(event.get("origin") == "change tray" for event in events) == 5


@pytest.mark.soak
def test_twelve_units_take_six_presses_and_the_number(site: Site, page: Page) -> None:
    opened(page, "/")
    presses = 0

    def press(target: Locator) -> None:
        nonlocal presses
        target.click()
        presses += 1

    press(page.get_by_role("link", name="Setpoints"))
    # On a busy machine a unit may respond late, and is left out then.
    expect(page.locator("[data-quality]:not([data-quality=online])")).to_have_count(0)
    press(page.get_by_role("button", name="Select all"))
    page.get_by_label("What to enter").select_option("value")
    press(page.get_by_label("Value for all selected", exact=True))
    page.keyboard.type("80.0")
    press(page.get_by_role("button", name="Enter values"))
    press(page.get_by_role("button", name="Review the change"))
    press(page.get_by_role("button", name=f"Set {UNITS} units now"))
    expect(page.locator("[data-review-done=good]")).to_be_visible(timeout=UNIT_MS)
    assert presses <= 6
    assert {site.unit(unit)["commanded"] for unit in range(1, UNITS + 1)} == {"80.0"}


def test_the_keyboard_alone_gathers_reviews_and_sends(site: Site, page: Page) -> None:
    opened(page, "/units/line/9")
    focus(page.locator("#setpoint"))
    page.keyboard.type("73.0")
    page.locator(".setter").get_by_role("button", name="Add to tray").press("Enter")
    expect(page.locator("#setpoint-error [data-added]")).to_be_visible()
    strip(page).get_by_role("link", name="Review the tray").press("Enter")
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator("[data-review-done=good]")).to_be_visible(timeout=UNIT_MS)
    assert site.unit(9)["commanded"] == "73.0"


@pytest.mark.soak
def test_another_window_follows_when_it_is_looked_at(page: Page, browser_page: OpensPages) -> None:
    add_setpoint(page, 8, "81.0")
    other = browser_page("engineer", viewport=PANEL)
    opened(other, "/alarms")
    expect(strip(other)).to_contain_text(re.compile(r"1 change\W+1 unit"))
    add_setpoint(page, 9, "82.0")
    other.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    expect(strip(other)).to_contain_text(re.compile(r"2 changes\W+2 units"))


@pytest.mark.soak
@pytest.mark.parametrize("locale", [GERMAN, ENGLISH])
def test_the_tray_is_accessible_and_covers_nothing_for_good(
    page: Page,
    browser_page: OpensPages,
    flaws: Callable[..., list[str]],
    local: Callable[[int], None],
    locale: str,
) -> None:
    for unit in (1, 2, 3):
        add_setpoint(page, unit, f"{60 + unit}.0")
    local(2)
    shown = browser_page("engineer", viewport=PHONE, locale=locale)
    opened(shown, "/tray")
    assert flaws(shown, locale) == []
    shown.set_viewport_size(PHONE)
    shown.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
    last = shown.locator("main button").last
    expect(last).to_be_in_viewport(ratio=1)
    above, below = edges(last), edges(strip(shown))
    assert above[1] <= below[0]
    assert below[1] <= edges(shown.locator(".rail"))[0] + 1
    strip(shown).locator("a.button").click()
    expect(shown.locator("[data-review-act]")).to_be_visible(timeout=UNIT_MS)
    shown.evaluate("document.querySelector('[data-lapse]').getAnimations().forEach(each => each.pause())")
    assert flaws(shown, locale) == []
