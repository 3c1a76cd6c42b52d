"""The list of alarms under a finger, and the alarm in the head of every page."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.pages import PANEL, PHONE, opened
from tests.e2e.site import AT_REST, NO_TENSION_ALARM, Site, eventually
from tests.e2e.test_unit import CLOCK
from tests.sizes import sizes

BETWEEN_TAPS_MS = 350
UNITS = (2, 3, 4)
MAX_ROW_PX = {1280: 56, 360: 140}
"""On a phone a hundred rows are in less than twenty screens."""
MIN_ROWS = 10
"""In the window of a panel, below the strip of a simulated line."""
STRIP_PX = 24
ROWS = """({ strip, row }) => {
    const { top } = document.querySelector("#alarms tbody").getBoundingClientRect();
    return (innerHeight - strip - top) / row;
}"""
MIN_TARGET_PX, MIN_GAP_PX = 48, 8
TARGETS = """rows => [...rows.querySelectorAll("button")].map(button => {
    const { left, top, right, bottom } = button.getBoundingClientRect();
    const [x, y] = [(left + right) / 2, (top + bottom) / 2];
    const isHit = (at, to) => button.contains(document.elementFromPoint(at, to));
    const reach = (across, down) => {
        let px = 0.5;
        while (isHit(x + px * across, y + px * down)) px += 0.5;
        return px - 0.5;
    };
    return { left: x - reach(-1, 0), top: y - reach(0, -1), right: x + reach(1, 0), bottom: y + reach(0, 1) };
})"""
"""What a finger presses of the button of each row, to half a pixel."""


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Eight units whose only alarms are those of the test."""
    return line_server(8, line_options=AT_REST, toml=NO_TENSION_ALARM)


def alarms(site: Site) -> dict[int, dict[str, Any]]:
    """The emergency stops that are present, by unit."""
    with site.api() as client:
        found = client.get("/alarms").json()["alarms"]
    return {alarm["unit"]: alarm for alarm in found if alarm["code"] == "estop_active"}


def stop(site: Site, unit: int, *, active: bool) -> None:
    site.line.remote.do("input", unit=unit, input="estop", on=active)


@pytest.fixture
def stopped(site: Site) -> Iterator[None]:
    """Three units with an emergency stop that no person has acknowledged."""
    for unit in UNITS:
        stop(site, unit, active=True)
    eventually(lambda: set(UNITS) <= set(alarms(site)), "three alarms")
    yield
    for unit in UNITS:
        stop(site, unit, active=False)
    eventually(lambda: all(not alarm["active"] for alarm in alarms(site).values()), "cleared")
    site.acknowledge_all()


PLACE = """row => {
    const { left, top, width, height } = row.getBoundingClientRect();
    return [left, top + scrollY + document.querySelector("main").scrollTop, width, height];
}"""


def places(page: Page) -> dict[int, list[float]]:
    """Where the rows are on the page, and how large."""
    return {unit: row(page, unit).evaluate(PLACE) for unit in UNITS}


URGENT = "rgb(193, 18, 31)"
"""--urgent by day (static/css/tokens.css)."""
RENAME = "(place, name) => { place.textContent = name; }"
BOXES = """() => [...document.querySelectorAll(".top, .top > *, .top__end > *")].map(part => {
    const { left, top, width, height } = part.getBoundingClientRect();
    return [part.className, left, top, width, height];
})"""
"""Where the parts of the head are, and how large."""


def check_targets(page: Page) -> None:
    """The buttons of the rows are in one column, each large enough for a glove, and apart."""
    targets = page.locator("#alarms tbody").evaluate(TARGETS)
    assert len(targets) == len(UNITS)
    assert len({one["left"] for one in targets}) == 1
    for at, one in enumerate(targets):
        size = min(one["right"] - one["left"], one["bottom"] - one["top"])
        assert size >= MIN_TARGET_PX - 1, "half a pixel at each end is not measured"
        assert all(one["bottom"] + MIN_GAP_PX <= other["top"] for other in targets[at + 1 :])


def row(page: Page, unit: int) -> Locator:
    return page.locator(f'[id="alarm-line.{unit}.estop_active"]')


def acknowledged(site: Site) -> set[int]:
    return {unit for unit, alarm in alarms(site).items() if alarm["acknowledged"]}


def tap_twice(page: Page, button: Locator) -> None:
    """Two taps at one place."""
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tap = (
        page.touchscreen.tap if page.evaluate("matchMedia('(pointer: coarse)').matches") else page.mouse.click
    )
    tap(x, y)
    page.wait_for_timeout(BETWEEN_TAPS_MS)
    tap(x, y)


@pytest.mark.parametrize(
    "context", sizes({"viewport": PANEL}, {"viewport": PHONE, "has_touch": True, "is_mobile": True})
)
@pytest.mark.usefixtures("stopped")
def test_two_taps_on_one_place_acknowledge_one_alarm_and_no_row_moves(
    site: Site, shared_page: OpensPages, context: dict[str, Any]
) -> None:
    page = opened(shared_page(taps=True, **context), "/alarms")
    before = places(page)
    heights = [height for _, _, _, height in before.values()]
    assert max(heights) <= MAX_ROW_PX[page.viewport_size["width"]]  # type: ignore[index]
    check_targets(page)
    if context["viewport"] == PANEL:
        assert page.evaluate(ROWS, {"strip": STRIP_PX, "row": max(heights)}) >= MIN_ROWS
    place = page.locator("#alarms .alarm__place > span").first
    name = place.inner_text()
    place.evaluate(RENAME, "Glättwerkzylinder-Oberwalzenantrieb-Nordseite-Trockenpartie")
    assert places(page) == before
    assert place.evaluate("place => place.scrollHeight > place.clientHeight"), "it is cut"
    place.evaluate(RENAME, name)
    order = page.locator("#alarms tbody tr").evaluate_all("rows => rows.map(row => row.id)")
    unit = int(order[0].split(".")[1])
    tap_twice(page, row(page, unit).get_by_role("button"))
    expect(row(page, unit)).to_contain_text("active, acknowledged")
    assert acknowledged(site) == {unit}
    expect(row(page, unit).get_by_role("button")).to_have_count(0)
    assert places(page) == before
    stop(site, unit, active=False)
    expect(row(page, unit)).to_contain_text("normal")
    assert places(page) == before
    with site.line.stopped(5):
        expect(row(page, 5)).to_contain_text("active, not acknowledged")
        assert places(page) == before, "a new alarm moves none"
    eventually(lambda: not alarms(site)[5]["active"], "cleared")
    page.get_by_role("link", name="Sort list").click()
    expect(row(page, unit)).to_have_count(0)


@pytest.mark.usefixtures("stopped")
def test_a_second_tap_that_hits_the_row_below_acknowledges_nothing(
    site: Site, browser_page: OpensPages
) -> None:
    page = browser_page(viewport=PANEL, taps=True)
    page.add_init_script(CLOCK)
    opened(page, "/alarms")
    page.evaluate("sessionStorage.setItem('test-now', Date.now())")
    buttons = page.locator("#alarms tbody button")
    expect(buttons).to_have_count(len(UNITS))
    boxes = [button.bounding_box() for button in buttons.all()]
    assert boxes[0]
    assert boxes[1]
    x, edge = boxes[0]["x"] + boxes[0]["width"] / 2, (boxes[0]["y"] + boxes[0]["height"] + boxes[1]["y"]) / 2
    page.mouse.click(x, edge - 12)
    page.mouse.click(x, edge + 12)
    expect(page.locator("#alarms tbody button")).to_have_count(len(UNITS) - 1)
    page.wait_for_timeout(BETWEEN_TAPS_MS)
    assert len(acknowledged(site)) == 1


def test_the_head_never_shows_an_alarm_that_is_over_as_active(site: Site, shared_page: OpensPages) -> None:
    site.acknowledge_all()
    page = opened(shared_page(viewport=PANEL, reduced_motion="no-preference"), "/events")
    head = page.locator(".top__alarm")
    expect(head).to_have_text(re.compile(r"^\s*No alarms\s*$"))
    boxes = page.evaluate(BOXES)
    stop(site, 2, active=True)
    expect(head).to_have_text(re.compile(r"1 alarm active\s*1 to acknowledge"))
    expect(head).to_have_attribute("data-is", "urgent waiting")
    expect(page.locator(".top__verdict")).to_contain_text(re.compile(r"active since \d\d:\d\d"))
    shape = head.locator(".alarm-priority__shape")
    urgent = shape.evaluate("shape => getComputedStyle(shape).backgroundColor")
    for same in (False, True, False):
        page.wait_for_function(
            "([shape, color, same]) => (getComputedStyle(shape).backgroundColor === color) === same",
            arg=[shape.element_handle(), urgent, same],
        )
    stop(site, 2, active=False)
    expect(head).to_have_text(re.compile(r"No alarm active\s*1 to acknowledge"))
    expect(head).to_have_attribute("data-is", "urgent cleared waiting")
    assert shape.evaluate("shape => getComputedStyle(shape).backgroundColor") != urgent
    assert page.evaluate(BOXES) == boxes, "nothing in the head moves"
    expect(page.locator("html[data-blink]")).to_have_count(0)
    site.line.remote.do("mode", unit=3, to="local")
    try:
        expect(head).to_have_text(re.compile(r"1 alarm active\s*2 to acknowledge"))
        expect(head).to_have_attribute("data-is", "low waiting")
        assert page.evaluate(BOXES) == boxes
    finally:
        site.line.remote.do("mode", unit=3, to="remote")
        site.end_alarms()
    expect(head).to_have_text(re.compile(r"^\s*No alarms\s*$"))


@pytest.mark.usefixtures("stopped")
def test_an_acknowledged_emergency_stop_keeps_its_shape_color_and_rank(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PANEL, reduced_motion="no-preference"), "/alarms")
    site.line.remote.do("mode", unit=5, to="local")
    try:
        site.acknowledge_all()
        first = page.locator("#alarms tbody tr").first
        expect(first).to_contain_text("active, acknowledged")
        for mark in (page.locator(".top__alarm"), first.locator(".alarm-priority")):
            expect(mark).to_have_attribute("data-is", "urgent")
            shape = mark.locator(".alarm-priority__shape")
            expect(shape).to_have_css("background-color", URGENT)
            expect(page.locator("html[data-blink]")).to_have_count(0)
            expect(shape).to_have_css("opacity", "1")
    finally:
        site.line.remote.do("mode", unit=5, to="remote")


IS_CUT = "part => part.scrollWidth > part.clientWidth || part.scrollHeight > part.clientHeight + 1"


@pytest.mark.parametrize("locale", sizes("de-DE", "en-GB"))
@pytest.mark.usefixtures("stopped")
def test_the_head_of_a_phone_names_unit_cause_and_time(shared_page: OpensPages, locale: str) -> None:
    """Where the name of the unit is a long one, that gives way to the cause and its time."""
    page = opened(shared_page(viewport=PHONE, locale=locale), "/events")
    verdict = page.locator(".top__words")
    name = verdict.locator(".verdict__name")
    expect(verdict).to_contain_text(re.compile(r"\d\d:\d\d"))

    def is_cut(part: Locator, unit: str) -> bool:
        # Again each time: a page whose connection was late gets all of its fields anew.
        name.evaluate(RENAME, unit)
        return bool(part.evaluate(IS_CUT))

    long_name = "Glättwerkzylinder-Oberwalzenantrieb Nord"
    for unit in ("Dryer 1", long_name):
        # The head is fitted once its words are there.
        eventually(lambda unit=unit: not is_cut(verdict, unit), "the complete cause in the head")  # type: ignore[misc]
    eventually(lambda: is_cut(name, long_name), "the name that gives way")
    alarms = page.locator(".top__alarm-words")
    assert not alarms.evaluate(IS_CUT)
