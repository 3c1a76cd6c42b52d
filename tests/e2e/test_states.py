"""Each state that a page of the line can be in: accessible by day on a wall and by night on a phone, large
enough for a glove, and in reach of the Tab key with a visible focus.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import AXE_LOOKS, AXE_RULES, ENGLISH, GERMAN, OpensPages
from tests.e2e.pages import FITTED, PANEL, PHONE, opened
from tests.e2e.site import AT_REST, Site, eventually
from tests.sizes import sizes

WALL = {"width": 1920, "height": 1080}
TARGET = 48
REASON = (
    "Bearing of the pressure roll is being changed, the belt is off and a fitter stands in the nip;"
    " ask Mr. Brown, phone 4711, or the control room"
)

TOO_SMALL = """target => [...document.querySelectorAll(
    "button, select, summary, .tabs__tab, .rail__item, .views__item, input:not([type=hidden])")]
  .filter(one => one.checkVisibility() && !one.closest("[inert]"))
  .map(one => one.closest("label.check") ?? one)
  .map(one => [one, one.getBoundingClientRect()])
  .filter(([, box]) => Math.min(box.width, box.height) < target - 0.5)
  .map(([one]) => one.outerHTML.slice(0, 160))"""
"""What a finger has to hit and is smaller than ``target`` pixels."""

BEHIND = """() => {
  const one = document.activeElement;
  if (one === document.body) return null;
  const {x, y, width, height} = one.getBoundingClientRect();
  const seen = document.elementFromPoint(x + width / 2, y + Math.min(height / 2, 20));
  const said = `${one.outerHTML.slice(0, 120)} behind ${seen?.outerHTML.slice(0, 80)}`;
  return one.matches(".skip") || one.contains(seen) || seen?.contains(one) ? "" : said;
}"""
"""What hides the middle of the element with the focus; null where nothing has it."""

HIDDEN_TO_THE_SIDE = """() => [...document.querySelectorAll("html, main .table-wrap")]
  .filter((each) => each.scrollWidth > each.clientWidth + 1).map((each) => each.ariaLabel)"""
FOR_A_PHONE = (
    *("/?view=tiles", "/units/line/1", "/setpoints", "/units/line/1/parameters", "/bus/line", "/users"),
    *("/account", "/nothing", "/events", "/sets", "/sets/compare", "/recipes", "/batch/line"),
)

Axe = Callable[..., list[str]]
Flaws = Callable[[Page, str], list[str]]


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Four units: the second in e-stop, the third in LOCAL and the fourth blocked."""
    made = line_server(4, line_options=AT_REST)
    made.line.remote.do("input", unit=2, input="estop", on=True)
    made.line.remote.do("mode", unit=3, to="local")
    with made.api("operator") as client:
        client.post("/buses/line/units/4/block", json={"reason": REASON}).raise_for_status()
    eventually(lambda: made.unit(2)["inputs"]["estop"] and not made.unit(3)["remote"], "the states are seen")
    return made


def judged(page: Page, axe: Axe) -> list[str]:
    """What axe finds in the state that the page is in: by night on a phone, and of what depends on colors and
    sizes, by day on a wall too."""
    found = []
    for size, scheme, rules in ((WALL, "light", AXE_LOOKS), (PHONE, "dark", AXE_RULES)):
        page.set_viewport_size(size)  # type: ignore[arg-type]
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        page.evaluate(FITTED)
        # A target that is half scrolled under the bar at the edge is not too small.
        page.evaluate("scrollTo(0, 0)")
        found += axe(page, only=rules)
    return found


@pytest.mark.parametrize("path", sizes("/units/line/2", "/", "/units/line/3", "/units/line/4", "/setpoints"))
def test_active_conditions_are_accessible(shared_page: OpensPages, axe: Axe, path: str) -> None:
    assert judged(opened(shared_page(), path), axe) == []


@pytest.mark.soak
def test_each_outcome_of_a_command_is_accessible_and_names_the_request(
    site: Site, shared_page: OpensPages, axe: Axe
) -> None:
    page = opened(shared_page("engineer", viewport=WALL), "/units/line/1")
    before = site.unit(1)["commanded"]
    with site.api("engineer") as client:
        assert client.put("/buses/line/units/1/limits", json={"highest": 9990}).status_code == 200
    page.locator("#setpoint").fill("999")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("#set-review")).to_contain_text("above its maximum display value")
    assert judged(page, axe) == []
    # A review lapses after 30 s, which axe may take on a machine that is busy.
    page.keyboard.press("Escape")
    page.locator("#setpoint").fill("999")
    page.get_by_role("button", name="Set now").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=bad]")).to_contain_text(
        "rejected by the unit: illegal speed value"
    )
    expect(page.locator(".done__requested")).to_have_text(f"requested 999.0 · reads {before}")
    assert judged(page, axe) == []
    with site.api("engineer") as client:
        assert client.put("/buses/line/units/1/limits", json={}).status_code == 200
    page.locator("#setpoint").fill("999")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("#setpoint-error")).to_contain_text("999.0 is outside 0.0 to 200.0")
    expect(page.locator("#setpoint-error .button")).to_be_in_viewport(ratio=1)
    assert judged(page, axe) == []


@pytest.mark.soak
def test_a_change_names_who_would_not_take_part_and_forgets_its_draft_when_it_is_done(
    shared_page: OpensPages, axe: Axe
) -> None:
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    for unit in (3, 4):
        expect(page.locator(f"[name=new-{unit}]:visible")).to_have_count(0)
    page.locator("[data-together-do=all]").click()
    expect(page.locator("[data-tick]:checked")).to_have_count(2)
    page.locator(".setpoints__new[name=new-1]").fill("50")
    page.evaluate("document.querySelector('[name=new-3]').value = '51'")
    page.get_by_role("button", name="Review the change").click()
    expect(page.locator("#review [data-remark=obstacle_not_in_remote]")).to_contain_text("not possible")
    expect(page.locator("#review [data-remark=obstacle_blocked]")).to_contain_text("left out")
    assert judged(page, axe) == []
    page.keyboard.press("Escape")  # as above
    page.get_by_role("button", name="Review the change").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review]:not([data-pending])")).to_have_count(1)
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator(".setpoints__new[name=new-1]")).to_have_value("50")
    page.evaluate("document.querySelector('[name=new-3]').value = ''")
    page.locator("[name=new-2]").fill("52")
    page.get_by_role("button", name="Review the change").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("verified at each of 2 units")
    expect(page.locator(".setpoints__new[name=new-1]")).to_have_value("")
    expect(page.locator("[data-tick]:checked")).to_have_count(0)


@pytest.mark.soak
@pytest.mark.parametrize("locale", sizes(ENGLISH, GERMAN))
def test_a_recipe_that_is_refused_is_accessible(
    site: Site, shared_page: OpensPages, flaws: Flaws, locale: str
) -> None:
    """The third of its units is in LOCAL, the fourth blocked."""
    with site.api("engineer") as client:
        recipe = client.post("/buses/line/recipes", json={"name": f"Sixty gram {locale}"}).raise_for_status()
    page = opened(shared_page("operator", viewport=PANEL, locale=locale), f"/recipes/{recipe.json()['id']}")
    page.locator(f"[hx-get$='/recipes/{recipe.json()['id']}/review']").click()
    expect(page.locator("#review [data-remark=obstacle_not_in_remote]")).to_be_visible()
    assert flaws(page, locale) == []


@pytest.mark.soak
@pytest.mark.parametrize("locale", [ENGLISH, GERMAN])
def test_a_group_change_that_fails_is_accessible(
    site: Site, shared_page: OpensPages, flaws: Flaws, locale: str
) -> None:
    page = opened(shared_page("engineer", viewport=PANEL, locale=locale), "/setpoints")
    with site.api("engineer") as client:
        assert client.put("/buses/line/units/1/limits", json={"highest": 9990}).status_code == 200
    try:
        page.locator("[name=new-1]").fill("999")
        page.locator("[name=new-2]").fill("52")
        page.locator("form[data-setpoints] [type=submit]").click()
        page.locator("[data-review-act]").click()
        # What became of each unit is above the buttons, and not cut off at their height.
        expect(page.locator("[data-review-done=bad] td").last).to_be_in_viewport(ratio=1)
        assert flaws(page, locale) == []
    finally:
        with site.api("engineer") as client:
            assert client.put("/buses/line/units/1/limits", json={}).status_code == 200


@pytest.mark.soak
@pytest.mark.parametrize("locale", [ENGLISH, GERMAN])
def test_an_undo_that_has_lapsed_is_accessible(
    site: Site, shared_page: OpensPages, flaws: Flaws, locale: str
) -> None:
    page = opened(shared_page("operator", viewport=PANEL, locale=locale), "/units/line/1")
    page.locator(".nudges button").first.click()
    undo = page.locator("#setpoint-error [data-undo] button")
    expect(undo).to_be_visible()
    before = site.unit(1)["commanded"]
    site.set_speed(1, value="55.0" if before != "55.0" else "56.0")
    undo.click()
    refused = page.get_by_text(re.compile("cannot be undone|nicht .*rückgängig"))
    expect(refused).to_be_visible()
    assert flaws(page, locale) == []


@pytest.mark.soak
def test_what_a_glove_presses_is_large_enough_and_nothing_is_hidden_to_the_side(
    browser_page: OpensPages,
) -> None:
    page = browser_page("admin", viewport=PHONE, is_mobile=True, has_touch=True)
    for path in FOR_A_PHONE:
        page.goto(path)
        expect(page.locator("h1").first).to_be_attached()
        assert page.evaluate(TOO_SMALL, TARGET) == [], path
        assert page.evaluate(HIDDEN_TO_THE_SIDE) == [], path


CUT_OFF = """() => [...document.querySelectorAll(
    ".tile__status .status__text, .rows__state .status__text, .tile__actual, .rows .alarm-priority--mark")]
  .filter(one => one.checkVisibility({visibilityProperty: true}))
  .map(one => [one, one.getBoundingClientRect(), one.closest("[data-unit]").getBoundingClientRect()])
  .filter(([one, box, unit]) => box.top < unit.top || box.bottom > unit.bottom + 0.5
    || box.right > unit.right + 0.5 || one.scrollWidth > one.clientWidth + 1)
  .map(([one]) => one.outerHTML.slice(0, 200))"""
"""Causes, numbers and marks of which a part is outside of their tile or row."""

PRESSED = """() => [...document.querySelectorAll(".line [data-unit], .fleet__tile")].flatMap(unit => {
  unit.scrollIntoView({block: "center", behavior: "instant"});
  const own = unit.matches("a") ? unit : unit.querySelector("[data-faceplate], .fleet__name a");
  const links = [own, unit.querySelector(".tile__alarm")];
  const {left, top, width, height} = unit.getBoundingClientRect();
  const steps = [...Array(13).keys()].map(step => step / 12);
  const points = steps.flatMap(i => steps.map(j => [left + 3 + (width - 6) * i, top + 3 + (height - 6) * j]));
  const hits = points.map(([x, y]) => document.elementFromPoint(x, y));
  const wrong = hits.filter(hit => !links.includes(hit?.closest("a") ?? null));
  if (hits.filter(hit => own.contains(hit)).length < 0.7 * hits.length) wrong.push(unit);
  return wrong.map(hit => `${unit.dataset.unit}: ${hit?.outerHTML.slice(0, 80)}`);
})"""
"""What of a unit a press hits that is neither the link to it nor its alarm, on a grid of points."""

COVERED = """() => [...document.querySelectorAll(".tile")].flatMap(tile => {
  const names = [".tile__head", ".tile__actual .value__number", ".status", ".tile__foot", ".bar"];
  const parts = names
    .map(part => tile.querySelector(part))
    .filter(part => part.checkVisibility({visibilityProperty: true}))
    .map(part => [part, part.getBoundingClientRect()]);
  return parts.flatMap(([one, box], at) => parts.slice(at + 1)
    .filter(([, other]) => box.bottom > other.top + 0.5 && other.bottom > box.top + 0.5
      && box.right > other.left + 0.5 && other.right > box.left + 0.5)
    .map(([other]) => `${tile.dataset.unit}: ${one.className}, ${other.className}`));
})"""
"""Parts of a tile of which one is over another."""


@pytest.mark.parametrize("locale", sizes("de-DE", "en-GB"))
def test_a_press_anywhere_on_a_unit_opens_it_and_no_part_is_cut_off_or_covers_another(
    shared_page: OpensPages, locale: str
) -> None:
    page = shared_page(viewport=PANEL, locale=locale)
    for path in ("/?view=tiles", "/?view=rows", "/?view=matrix", "/lines"):
        opened(page, path)
        for width in (320, 360, 620, 1024, 1280, 1920):
            page.set_viewport_size({"width": width, "height": 800})
            page.evaluate(FITTED)
            assert page.evaluate(CUT_OFF) == [], f"{path}, {width}"
            assert page.evaluate(COVERED) == [], f"{path}, {width}"
            if width in (360, 1280, 1920):
                assert page.evaluate(PRESSED) == [], f"{path}, {width}"


@pytest.mark.parametrize("locale", sizes("de-DE", "en-GB"))
def test_a_small_panel_has_room_for_the_verdict_and_scrolls_nothing_sideways(
    shared_page: OpensPages, locale: str
) -> None:
    page = opened(shared_page(viewport={"width": 1024, "height": 768}, locale=locale), "/setpoints")
    room = "one => one.getBoundingClientRect().right <= one.closest('p').getBoundingClientRect().right"
    assert page.locator(".top__words").evaluate(room)
    name = page.locator(".setpoints tbody th > a").first
    name.evaluate("one => one.textContent = 'Unwind of the second coating line, dry e'")
    for wide in ("html", ".table-wrap"):
        assert page.locator(wide).first.evaluate("one => one.scrollWidth <= one.clientWidth"), wide
    table = page.locator(".table-wrap").first
    assert table.get_attribute("tabindex") is None, "a stop of the Tab key without anything to scroll"
    table.evaluate("one => one.style.cssText = 'inline-size: 10rem; overflow-x: auto'")
    page.evaluate("dispatchEvent(new Event('resize'))")
    expect(table).to_have_attribute("tabindex", "0")


@pytest.mark.parametrize(
    ("path", "size"), sizes(("/units/line/1", PHONE), ("/setpoints", PANEL), ("/", PHONE))
)
def test_the_tab_key_reaches_the_end_with_a_visible_focus(
    shared_page: OpensPages, path: str, size: dict[str, int]
) -> None:
    page = opened(shared_page("engineer", viewport=size), path)
    hidden = []
    for _ in range(120):
        page.keyboard.press("Tab")
        behind = page.evaluate(BEHIND)
        if behind is None:
            break
        hidden += [behind] if behind else []
    else:
        pytest.fail("the Tab key does not reach the end of the page")
    assert hidden == []


@pytest.mark.soak
def test_a_unit_that_does_not_respond_shows_why_nothing_can_be_set(
    site: Site, shared_page: OpensPages, axe: Axe
) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/1")
    notice = page.locator(".setting__offline")
    expect(notice).to_be_hidden()
    site.line.remote.do("fault", kind="dead", rate=1, unit=1)
    try:
        expect(notice).to_contain_text("until live values")
        assert judged(page, axe) == []
    finally:
        site.line.remote.do("clear")
    expect(notice).to_be_hidden()


@pytest.mark.soak
@pytest.mark.provokes("ERR_CONNECTION_REFUSED")
def test_without_its_server_a_page_is_accessible(site: Site, browser_page: OpensPages, axe: Axe) -> None:
    page = opened(browser_page(viewport=PANEL), "/units/line/1")
    site.stop()
    try:
        expect(page.locator("body[data-link=lost]")).to_be_attached()
        assert judged(page, axe) == []
    finally:
        site.start()


def test_a_page_whose_scripts_do_not_load_states_that_its_values_stand_still(
    shared_page: OpensPages, browser_page: OpensPages
) -> None:
    page = browser_page("operator", viewport=PANEL, java_script_enabled=False)
    page.goto("/units/line/1")
    expect(page.get_by_text("The values on this page do not change")).to_be_visible()
    expect(page.get_by_role("link", name="Reload page")).to_be_in_viewport()
    scripted = opened(shared_page("operator", viewport=PANEL), "/units/line/1")
    expect(scripted.get_by_text("The values on this page do not change")).to_be_hidden()
