"""Every page of the line as it looks: judged for accessibility, at phone and wall size, in both languages."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import cycle, product

import pytest
from playwright.sync_api import Page, Response, WebSocketRoute, expect

from app.core.help.handbook import WITH_A_PAGE
from tests.e2e.conftest import ENGLISH, GERMAN, PANEL_PX, SIZES, UNCOVERED, OpensPages, sign_in
from tests.e2e.limits import UNIT_MS
from tests.e2e.pages import BESIDE_THE_RAIL, PANEL, PHONE, WALKED, count_shifts, shifts
from tests.e2e.site import Site, eventually
from tests.sizes import sizes

RUNNING = re.compile(r"^\s*Running 119\.4 m/min · all 8 at speed\s*$")


def opened(page: Page, path: str) -> Page:
    """Open a page and wait until it follows the line."""
    opened_with_response(page, path)
    return page


def opened_with_response(page: Page, path: str) -> Response:
    response = page.goto(path)
    assert response is not None
    expect(page.locator("body[data-link=live]")).to_be_attached()
    page.evaluate("async () => { await document.fonts.ready }")  # until then letters are those of the panel
    return response


def too_wide(page: Page) -> int:
    """By how many pixels the page is wider than its window."""
    found: int = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    return found


LOOKS = list(product((ENGLISH, GERMAN), SIZES))


@pytest.mark.parametrize("look", range(len(LOOKS)))
def test_each_page_is_accessible_in_one_of_its_looks(
    shared_page: OpensPages, axe: Callable[..., list[str]], look: int
) -> None:
    """``make soak`` has each in all of them."""
    locale, (width, height) = LOOKS[look]
    page = shared_page("admin", locale=locale)
    page.set_viewport_size({"width": width, "height": height})
    wrong: dict[str, list[str]] = {}
    for scheme, path in zip(cycle(("light", "dark")), WALKED[look :: len(LOOKS)], strict=False):
        page.emulate_media(color_scheme=scheme)
        response = opened_with_response(page, path)
        if response.ok and path not in BESIDE_THE_RAIL:
            expect(page.locator(".rail__item[aria-current]:visible")).to_be_in_viewport(ratio=1)
        wrong[path] = flaws_here(page, axe, width)
    assert {path: flaws for path, flaws in wrong.items() if flaws} == {}


@pytest.mark.parametrize("locale", sizes(ENGLISH, GERMAN))
def test_a_page_outside_of_the_line_is_accessible(
    site: Site, shared_page: OpensPages, axe: Callable[..., list[str]], locale: str
) -> None:
    page = shared_page(None, viewport=PHONE, locale=locale)
    for role, path in ((None, "/login"), ("viewer", "/nothing")):
        sign_in(page, site, role)
        page.goto(path)
        assert flaws_here(page, axe, PHONE["width"]) == [], path


def flaws_here(page: Page, axe: Callable[..., list[str]], width: int) -> list[str]:
    """What is wrong with an open page as it looks now. On the wall no color differs from a panel
    (tests/app/test_styles.py), and targets are closest on a phone; both are two thirds of what axe costs."""
    page.evaluate(UNCOVERED)
    wrong = ["too wide"] if too_wide(page) > 0 else []
    if page.evaluate("document.documentElement.translate"):
        wrong.append("a browser may translate it, which hides what is true")
    left_out = ["target-size"] * (width > PHONE["width"]) + ["color-contrast"] * (width > PANEL_PX)
    return wrong + axe(page, *left_out)


@pytest.mark.soak
@pytest.mark.parametrize(
    ("path", "locale"),
    [*((path, locale) for path in WALKED for locale in (ENGLISH, GERMAN)), ("/docs", ENGLISH)],
)
def test_a_page_is_accessible_and_fits_its_window(
    shared_page: OpensPages, flaws: Callable[..., list[str]], path: str, locale: str
) -> None:
    page = shared_page("admin", viewport=PHONE, locale=locale)
    has_place = opened_with_response(page, path).ok and path not in BESIDE_THE_RAIL
    current = page.locator(".rail__item[aria-current]:visible")
    if has_place:
        expect(current).to_be_in_viewport(ratio=1)
    assert flaws(page, locale) == []
    if has_place:
        expect(current).to_be_in_viewport(ratio=1)


@pytest.mark.parametrize("locale", sizes(GERMAN, ENGLISH))
def test_the_page_of_each_role_is_one_sheet_of_paper(shared_page: OpensPages, locale: str) -> None:
    page = shared_page("engineer", viewport=PANEL, locale=locale)
    for role in WITH_A_PAGE:
        opened(page, f"/help/{role}-page")
        assert page.locator("article.help").get_attribute("lang") == locale[:2]
        paper = page.pdf(format="A4", prefer_css_page_size=True)
        assert len(re.findall(rb"/Type */Page[^s]", paper)) == 1, role


@pytest.mark.soak
def test_an_engineer_adds_changes_and_removes_an_alarm(
    shared_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    page = opened(shared_page("engineer", viewport=PHONE), "/alarms/own")
    page.get_by_label("Name", exact=True).fill("Far too fast")
    page.get_by_label("Above", exact=True).fill("90000")
    page.get_by_role("button", name="Simulate alarm").press("Enter")
    page.get_by_role("button", name="Add alarm").press("Enter")
    page.get_by_role("button", name="Change alarm: Far too fast").press("Enter")
    expect(page.get_by_label("Name", exact=True)).not_to_be_editable()
    page.get_by_label("Above", exact=True).fill("80000")
    page.get_by_role("button", name="Change without simulation").press("Enter")
    row = page.get_by_role("row").filter(has_text="Far too fast")
    expect(row).to_contain_text("80000")
    row.locator("summary").press("Enter")
    row.get_by_label("Reason").fill("no longer needed")
    assert flaws(page, ENGLISH) == []
    row.get_by_role("button", name="Confirm removal").press("Enter")
    expect(page.get_by_role("row").filter(has_text="Far too fast")).to_have_count(0)


def test_a_line_with_faults_names_them(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/")
    expect(page.locator("h1 a[href]")).to_have_count(0)
    site.line.remote.do("input", unit=2, input="estop", on=True)
    site.line.remote.do("mode", unit=3, to="local")
    try:
        expect(page.locator("h1")).to_have_text(
            re.compile(r"Infeed nip · Stopped: emergency stop active since \d\d:\d\d")
        )
        expect(page.locator("h1 a")).to_have_attribute("href", "/units/line/2")
        expect(page.locator('[data-unit="line/3"] .status')).to_contain_text("Not in REMOTE")
        expect(page).to_have_title("(2) Line · Lineside")
    finally:
        site.line.remote.do("input", unit=2, input="estop", on=False)
        site.line.remote.do("mode", unit=3, to="remote")
    expect(page.locator("h1")).to_have_text(RUNNING, timeout=UNIT_MS)


def test_nothing_shifts_as_the_first_values_arrive_nor_later(site: Site, browser_page: OpensPages) -> None:
    site.end_alarms()
    page = browser_page(viewport=PANEL)
    release = hold_messages(page)
    page.goto("/")
    count_shifts(page)
    release()
    expect(page.locator("body[data-link=live]")).to_be_attached()
    counted = page.locator("[data-clock]").first
    for beat in ("the heartbeat", "another heartbeat"):
        before = counted.inner_text()
        eventually(lambda before=before: counted.inner_text() != before, beat)  # type: ignore[misc]
    assert shifts(page) == []


def hold_messages(page: Page) -> Callable[[], None]:
    """Keep the messages of the server from ``page`` until the returned function is called."""
    held: list[tuple[WebSocketRoute, str | bytes]] = []
    released = False

    def connected(browser: WebSocketRoute) -> None:
        def receive(message: str | bytes) -> None:
            if released:
                browser.send(message)
            else:
                held.append((browser, message))

        browser.connect_to_server().on_message(receive)

    def release() -> None:
        nonlocal released
        released = True
        for browser, message in held:
            browser.send(message)

    page.route_web_socket("**/live?*", connected)
    return release


def test_a_press_opens_the_faceplate_beside_the_line_and_the_keyboard_closes_it_and_goes_on(
    site: Site, shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    """Its lamps that are lit and the names of its numbers are read aloud."""
    eventually(lambda: site.unit(5)["inputs"]["run"], "the run input seen")
    page = opened(shared_page(viewport=PANEL), "/")
    link = page.locator('[data-unit="line/5"] [data-faceplate]')
    link.click()
    plate = page.locator("#faceplate")
    expect(plate.locator("h2")).to_have_text(site.unit(5)["name"])
    for unit in range(1, 9):
        expect(page.locator(f'.tile[data-unit="line/{unit}"]')).to_be_in_viewport(ratio=1)
    expect(plate).to_be_in_viewport()
    plate.get_by_label("New setpoint").fill("120")
    plate.get_by_role("button", name="Set now").click()
    expect(plate.locator("[data-review]")).to_contain_text("120.0")
    assert axe(page, part="#faceplate") == []
    plate.locator(".faceplate__state .status__text").evaluate(
        "each => each.textContent = 'cause '.repeat(40)"
    )
    shown = plate.locator(".faceplate__state").evaluate("each => [each.scrollHeight, each.clientHeight]")
    assert shown[0] == shown[1], "a long cause lies over what follows"
    aloud = plate.aria_snapshot()
    assert "actual" in aloud
    assert "Run input on" in aloud
    assert "Preset input" not in aloud
    page.keyboard.press("Escape")
    expect(page.locator("[data-review-act]")).to_have_count(0)
    expect(plate).to_be_visible()
    page.keyboard.press("Escape")
    expect(plate).to_be_hidden()
    expect(link).to_be_focused()
    page.keyboard.press("Enter")
    expect(plate.locator("h2 a")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page).to_have_url("/units/line/5")


@pytest.mark.parametrize("size", sizes(PANEL, PHONE), ids=["panel", "phone"])
def test_a_speed_is_set_beside_the_line_by_three_presses_of_the_unit_that_was_opened_last(
    site: Site, shared_page: OpensPages, size: dict[str, int]
) -> None:
    before = site.unit(6)["commanded"]
    after = "90.0" if before != "90.0" else "91.0"
    page = opened(shared_page(viewport=size), "/?view=tiles")
    plate = page.locator("#faceplate")
    field = plate.get_by_label("New setpoint")
    if size == PANEL:  # on a phone the sheet lies over the other units
        page.locator('[data-unit="line/2"] [data-faceplate]').click()
        expect(field).to_be_visible()
        field.fill("77.7")
        page.get_by_role("button", name="Set now").click()
        expect(plate.locator("[data-review]")).to_be_visible()
    page.locator('[data-unit="line/6"] [data-faceplate]').click()
    expect(page.locator("#faceplate-name")).to_have_text(site.unit(6)["name"])
    expect(page.locator("[data-review]")).to_have_count(0)
    expect(field).to_have_value(before)
    field.fill(after)
    plate.get_by_role("button", name="Set now").click()
    expect(plate.locator(".change__new")).to_contain_text(after)
    expect(page.locator('.tile[data-unit="line/6"]')).to_be_in_viewport()
    plate.locator("[data-review-act]").click()
    expect(plate.get_by_text(f"reads {after}")).to_be_in_viewport()
    expect(plate.get_by_role("button", name="Undo")).to_be_visible()
    expect(page.locator("dialog[open], [data-review]")).to_have_count(0)
    assert site.unit(6)["commanded"] == after
    site.set_speed(6, value="66.6")
    expect(field).to_have_value("66.6")


def test_a_cell_of_the_matrix_draws_its_unit_and_opens_it_in_a_sheet_below_the_line_on_a_phone(
    shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    page = opened(shared_page(viewport=PHONE), "/?view=matrix")
    expect(page.locator(".cell__pointer:not([data-step=''])")).to_have_count(8)
    drawn = page.locator(".cell__pointer").evaluate_all(
        "pointers => pointers.map(pointer => getComputedStyle(pointer).backgroundImage)"
    )
    assert all("gradient" in image for image in drawn), drawn
    page.locator('[data-unit="line/8"]').click()
    expect(page.locator("#faceplate h2 a")).to_be_focused()
    expect(page.locator('.cell[data-unit="line/8"]')).to_be_in_viewport(ratio=1)
    assert too_wide(page) <= 0
    assert axe(page) == []
    page.get_by_role("button", name="Close").click()
    expect(page.locator("#faceplate")).to_be_hidden()


def test_a_viewer_sees_no_control(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=PANEL), "/units/line/1")
    expect(page.locator(".main [data-command]")).to_have_count(0)
    page.get_by_role("button", name="Set line to zero").click()
    expect(page.locator("#review")).to_contain_text("Setting the line to zero needs the role operator")
    expect(page.locator("[data-review-act]")).to_have_count(0)
    opened(page, "/setpoints")
    expect(page.locator(".main [data-command], [data-new]")).to_have_count(0)
