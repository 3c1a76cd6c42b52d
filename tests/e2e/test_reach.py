"""Controls are in reach and texts visible from phone to wall; nothing lies on another part or is cut."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from fastapi.routing import APIRoute
from playwright.sync_api import Locator, Page, expect

from app.main import FEATURES
from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.pages import FITTED, NEEDS_MORE, NO_PAGES, PAGES, PANEL, WALKED, opened
from tests.e2e.site import AT_REST, Site, eventually
from tests.sizes import sizes

WIDTHS = (360, 640, 768, 1000)
COVERED = """() => {
  const pressed = "a[href], button, summary, input:not([type=hidden]), select, textarea";
  const said = [];
  for (const one of document.querySelectorAll(pressed)) {
    if (!one.checkVisibility({checkVisibilityCSS: true}) || one.closest("[inert], .skip")) continue;
    scrollTo(0, 0);
    one.scrollIntoView({block: "nearest", inline: "nearest", behavior: "instant"});
    const {x, y, width, height} = one.getClientRects()[0] ?? {width: 0};
    if (!width) continue;
    const seen = document.elementFromPoint(x + width / 2, y + height / 2);
    if (!one.contains(seen) && one.closest("label") !== seen?.closest("label"))
      said.push(`${one.outerHTML.slice(0, 100)} behind ${seen?.outerHTML.slice(0, 60)}`);
    else if (!seen) said.push(`${one.outerHTML.slice(0, 100)} outside`);
  }
  return said;
}"""
"""Controls that are covered after they were scrolled into view, as the focus would do."""
TOO_WIDE = """() => [...document.querySelectorAll("html, .table-wrap")]
  .map(one => one.scrollWidth - one.clientWidth).filter(over => over > 0)"""
CUT = """() => [...document.querySelectorAll(".table--events td, .parts :is(td, th)")]
  .filter(cell => cell.checkVisibility({contentVisibilityAuto: true}))
  .filter(cell => cell.scrollWidth > cell.clientWidth + 1)
  .map(cell => cell.textContent.trim())"""
NAMES = (
    "Glättwerkzylinder-Oberwalzenantrieb-Nordseite-Trockenpartie",
    "Donaudampfschifffahrtsgesellschaftskapitänsmützenfabrikbande",
    "وحدة سحب الورق الرئيسية في نهاية خط التجفيف الشمالي بجانب آلة اللف",
)
RENAME = "(name, text) => { name.textContent = text; }"
IS_CUT = "name => getComputedStyle(name).overflow === 'hidden' && name.scrollWidth > name.clientWidth"
HAS_ELLIPSIS = (
    "name => getComputedStyle(name).textOverflow === 'ellipsis' && name.scrollHeight <= name.clientHeight"
)
Axe = Callable[..., list[str]]


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Eight units that were changed together."""
    made = line_server(8, line_options=AT_REST)
    setpoints: dict[str, Any] = {str(unit): {"raw": 1000 + unit} for unit in range(1, 9)}
    with made.api("operator") as client:
        client.post("/buses/line/speeds", json={"setpoints": setpoints}).raise_for_status()
    return made


@pytest.mark.parametrize("path", sizes(*WALKED))
def test_nothing_lies_over_what_can_be_pressed(shared_page: OpensPages, path: str) -> None:
    page = opened(shared_page("admin", viewport={"width": 1280, "height": 600}), path)
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 600})
        page.evaluate(FITTED)
        assert page.evaluate(COVERED) == [], width
    page.set_viewport_size(PANEL)
    overflow = "rail => rail.scrollHeight - rail.clientHeight"
    assert page.locator(".rail").evaluate_all(f"rails => rails.map({overflow})") in ([], [0])


def test_every_page_is_walked() -> None:
    routes = {
        route.path
        for feature in FEATURES
        for router in feature.routers
        for route in router.routes
        if isinstance(route, APIRoute) and "GET" in route.methods and not route.path.startswith("/api/")
    }
    assert routes == {*PAGES, *NEEDS_MORE, *NO_PAGES}


@pytest.mark.soak
def test_nothing_lies_over_the_rows_of_a_restore(site: Site, shared_page: OpensPages) -> None:
    unit = "/buses/line/units/1"
    with site.api("engineer") as client:
        taken = client.post("/buses/line/sets", json={"units": [1]}).raise_for_status().json()
        client.put(f"{unit}/parameters/6", json={"raw": 77}).raise_for_status()
        plan = client.post(f"{unit}/restores", json={"set": taken["id"]}).raise_for_status().json()
    page = shared_page("engineer", viewport={"width": 1280, "height": 600}, locale="de-DE")
    opened(page, f"/restores/{plan['id']}")
    expect(page.get_by_role("checkbox").first).to_be_visible()
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 600})
        page.evaluate(FITTED)
        assert page.evaluate(COVERED) == [], width


@pytest.mark.parametrize("width", sizes(360, 700, 1280))
def test_a_group_change_opens_at_its_head_and_its_result_at_the_verdict(
    shared_page: OpensPages, width: int
) -> None:
    page = opened(shared_page("operator", viewport={"width": width, "height": 520}), "/setpoints")
    page.locator("[data-together-do=all]").click()
    page.locator("[data-together=scale]").fill("101")
    page.locator("[data-together-do=enter]").click()
    page.locator("form[data-setpoints] [type=submit]").click()
    act = page.locator("[data-review-act]")
    expect(page.locator("#review-title")).to_be_in_viewport(ratio=1)
    expect(act).to_be_in_viewport(ratio=1)
    expect(page.locator("[data-review-cancel]")).to_be_focused()
    act.click()
    expect(page.locator("dialog[open]")).to_have_count(0)
    expect(page.locator("#change-line [data-review-done]")).to_be_in_viewport(ratio=1)
    expect(page.locator("#change-line [data-undo] button")).to_be_in_viewport(ratio=1)


@pytest.mark.parametrize("width", sizes(360, 820, 1280, 1920))
def test_a_change_of_many_units_is_one_row_that_fits_and_on_paper_has_all_of_them(
    shared_page: OpensPages, axe: Axe, width: int
) -> None:
    page = opened(shared_page("viewer", viewport={"width": width, "height": 900}), "/events?kind=command")
    parts = page.locator(".event__parts", has_text="8 units: 8 verified").last
    expect(parts).to_be_visible()
    assert page.evaluate(TOO_WIDE) == []
    assert page.evaluate(CUT) == []
    parts.locator("summary").focus()
    page.keyboard.press("Enter")
    shown = parts.locator("tbody tr")
    expect(shown).to_have_count(8)
    expect(shown.first).to_contain_text("1 Unwind")
    expect(shown.first).to_contain_text("→ 100.1")
    expect(shown.first).to_contain_text("verified")
    assert page.evaluate(TOO_WIDE) == []
    assert page.evaluate(CUT) == []
    assert axe(page, part=".table--events") == []
    page.keyboard.press("Enter")
    expect(shown.first).to_be_hidden()
    page.set_viewport_size({"width": 794, "height": 1123})
    page.emulate_media(media="print")
    expect(shown.first).to_be_visible()
    assert page.evaluate(TOO_WIDE) == []
    assert page.evaluate(CUT) == []


def focused(page: Page, link: Locator) -> None:
    """Put the focus on a link as a key does."""
    page.keyboard.press("Tab")
    link.focus()


@pytest.mark.parametrize(
    ("view", "width"), sizes(("matrix", 360), ("matrix", 1280), ("tiles", 1280), ("rows", 1280))
)
def test_a_cut_name_has_an_ellipsis_and_is_complete_at_the_focus(
    site: Site, shared_page: OpensPages, view: str, width: int
) -> None:
    page = shared_page("viewer", viewport={"width": width, "height": 740})
    page.goto(f"/?view={view}")
    expect(page.locator("body[data-link=live]")).to_be_attached()
    for unit, text in enumerate(NAMES, start=1):
        name = page.locator(f'[data-unit="line/{unit}"] :is(.cell__name, .tile__name a, .rows__name a)')
        assert name.get_attribute("title") == site.unit(unit)["name"]
        name.evaluate(RENAME, text)
        # The line takes its size once the page is drawn.
        eventually(partial(name.evaluate, IS_CUT), "the name cut")
        assert name.evaluate(HAS_ELLIPSIS)
        link = name.locator("xpath=ancestor-or-self::a")
        assert text in link.aria_snapshot()
        focused(page, link)
        assert not name.evaluate(IS_CUT)
        link.evaluate("link => link.blur()")
        eventually(partial(name.evaluate, IS_CUT), "the name cut again")


# --- what jams ------------------------------------------------------------------------------------------

MAX_SCREENS = 12
SCREENS = "document.documentElement.scrollHeight / innerHeight"
JAMS = (Path(__file__).parent / "jams.js").read_text(encoding="utf-8")
SIZES = ((360, 800), (1280, 800), (1920, 1080))
ADD_STYLE = """style => {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(style);
  document.adoptedStyleSheets.push(sheet);
}"""
PATHS = [
    *("/", "/?view=rows", "/units/line/1", "/units/line/1/parameters", "/units/line/1/restore"),
    *("/setpoints", "/batch/line", "/bus/line", "/trends", "/alarms", "/alarms/journal"),
    *("/alarms/performance", "/alarms/own", "/events", "/shifts", "/shifts/present", "/reports", "/sets"),
    *("/sets/1", "/sets/compare?left=golden:line:1&right=live:line:1", "/recipes", "/recipes/1"),
    *("/notifications", "/configuration", "/configuration/tables/bus.0.unit.0", "/account", "/system"),
]
MORE = ["/?view=matrix", "/docs", "/help", "/wallboard", "/alarms/line.1.estop_active.0"]


def jams(page: Page, path: str) -> list[str]:
    """Those of a page, each with the width at which it was seen."""
    page.goto(path)
    expect(page.locator("h1").first).to_be_attached()
    return jams_as_shown(page)


def jams_as_shown(page: Page) -> list[str]:
    """Those of what a page shows now."""
    found = []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate(FITTED)
        found += [f"{width} px: {jam}" for jam in page.evaluate(JAMS)]
    return found


def test_nothing_jams_beside_the_line_nor_with_a_message_or_an_undo_on_the_page_of_a_unit(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page("engineer", site=site, locale=GERMAN, viewport=PANEL), "/?view=tiles")
    page.locator('[data-unit="line/5"] [data-faceplate]').click()
    expect(page.locator("#faceplate #setpoint")).to_be_visible()
    assert page.evaluate(JAMS) == []
    page.goto("/units/line/2")
    page.locator(".setting .nudges button").nth(1).click()
    expect(page.locator(".setting .undo:visible")).to_be_visible()
    opened(page, "/units/line/2")
    expect(page.locator(".setting .undo-place .undo")).to_be_visible()
    assert jams_as_shown(page) == []
    page.locator("#setpoint").fill("90,0")
    page.locator(".setter__tray").click()
    expect(page.locator("#setpoint-error [data-added]")).to_be_visible()
    expect(page.locator(".setting .undo:visible")).to_have_count(0)
    assert jams_as_shown(page) == []


@pytest.mark.soak
@pytest.mark.parametrize(
    ("style", "words"),
    [
        (".setter__now { margin-block-start: -30px }", "lies on"),
        (".pad { display: none } .setter { gap: 0 }", "too near"),
        (".pad { block-size: 90px; overflow: hidden }", "is cut by"),
        (".card__head { margin-block-end: -60px }", "lies on the text"),
    ],
)
def test_a_jam_is_found(site: Site, shared_page: OpensPages, style: str, words: str) -> None:
    page = shared_page("engineer", site=site, viewport={"width": 1280, "height": 800})
    page.goto("/units/line/1")
    expect(page.locator("body[data-link=live]")).to_be_attached()
    page.evaluate(ADD_STYLE, style)
    # Its buttons are disabled until the unit is online.
    page.wait_for_function(f"words => ({JAMS})().some(jam => jam.includes(words))", arg=words)


@pytest.mark.soak
@pytest.mark.parametrize("locale", [ENGLISH, GERMAN])
@pytest.mark.parametrize("path", [*PATHS, *MORE])
def test_nothing_jams_on_any_page_and_none_is_longer_than_twelve_screens_of_a_phone(
    past_site: Site, shared_page: OpensPages, path: str, locale: str
) -> None:
    page = shared_page("engineer", site=past_site, locale=locale)
    assert jams(page, path) == []
    page.set_viewport_size({"width": 360, "height": 800})
    assert path in MORE or page.evaluate(SCREENS) <= MAX_SCREENS


@pytest.mark.soak
def test_a_long_word_widens_no_page(site: Site, shared_page: OpensPages) -> None:
    named: dict[str, Any] = {"name": "W" * 80, "comment": "W" * 80}
    with site.api("admin") as client:
        # Once the ranges of setpoints are read.
        recipe = named | {"setpoints": {"1": 700}}
        eventually(lambda: client.post("/buses/line/recipes", json=recipe).is_success, "a recipe")
        client.post("/buses/line/sets", json=named | {"units": [1]}).raise_for_status()
    page = shared_page("admin", viewport={"width": 360, "height": 800})
    view = {"name": "W" * 80, "query": "s=line/1/actual"}
    page.request.post("/trends/views", form=view, headers={"Origin": site.url})
    for path in ("/recipes", "/recipes/1", "/sets", "/sets/1", "/trends"):
        opened(page, path)
        page.evaluate("for (const each of document.querySelectorAll('#trend-views')) each.open = true")
        expect(page.get_by_text("W" * 80).first).to_be_attached()
        assert page.evaluate(TOO_WIDE) == [], path


@pytest.mark.soak
def test_no_key_lies_on_a_step_in_the_narrowest_window(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", site=site, locale=GERMAN, viewport={"width": 320, "height": 640})
    page.goto("/units/line/1")
    expect(page.locator("#setpoint")).to_be_visible()
    assert page.evaluate(JAMS) == []
