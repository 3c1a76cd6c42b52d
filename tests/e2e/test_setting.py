"""Setting a speed, an output, a parameter and a line as a person does it, checked against the wire."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from tests.e2e import pages
from tests.e2e.conftest import OpensPages, focus
from tests.e2e.limits import PAGE_S
from tests.e2e.pages import PANEL
from tests.e2e.site import Site, eventually


def state(site: Site, unit: int) -> dict[str, Any]:
    """A simulated unit from inside."""
    found: dict[str, Any] = site.line.remote.do("state", unit=unit)
    return found


def opened(page: Page, path: str) -> Page:
    """A page whose link is up, of a unit with a value of this second: while no page was open, saves of
    parameters had the wire, and a review of an older value ends at once."""
    pages.opened(page, path)
    if re.fullmatch(r"/units/line/\d+", path):
        expect(page.locator(".plate [data-age]").first).to_have_text(re.compile(r"^0\.\d s$"))
    return page


def type_on_pad(page: Page, text: str) -> None:
    for key in text:
        page.locator(f'[data-pad="{key}"]').click()


def test_nothing_leaves_before_the_confirm_and_enter_only_reviews(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/3")
    before = site.writes()
    type_on_pad(page, "101.5")
    page.get_by_role("button", name="Set now").click()
    confirm = page.get_by_role("button", name=re.compile(r"^Set .* to 101\.5$"))
    expect(confirm).to_be_visible()
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    assert site.writes() == before
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("[data-review]")).to_have_count(0)
    page.locator("#setpoint").fill("99,5")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("[data-review]")).to_have_count(0)
    page.locator("#setpoint").fill("99,5")
    page.keyboard.press("Enter")
    expect(page.locator("[data-review]")).to_have_count(1)
    page.keyboard.press("Escape")
    expect(page.locator("[data-review]")).to_have_count(0)
    assert site.writes() == before

    page.locator("#setpoint").fill("")
    type_on_pad(page, "101.5")
    page.get_by_role("button", name="Set now").click()
    confirm.click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("verified: reads 101.5")
    assert state(site, 3)["setpoint"] == 1015
    assert len(site.writes()) == len(before) + 1


def test_keyboard_alone_sets_a_speed_that_no_message_removes(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/4")
    field, cancel = page.locator("#setpoint"), page.get_by_role("button", name="Cancel")
    expect(page.locator(".nudges button").first).to_be_visible()
    focus(field)
    site.set_speed(4, value="90.0")
    expect(field).to_have_value("90.0")
    page.keyboard.type("88.0")
    expect(field).to_have_value("88.0")
    page.keyboard.press("Enter")
    expect(cancel).to_be_focused()
    page.evaluate("document.dispatchEvent(new CustomEvent('lineside:lost'))")
    expect(page.locator("[data-review]")).to_have_count(0)
    expect(page.locator("[data-review-end]")).to_contain_text("Nothing was sent")
    expect(field).to_have_value("88.0")
    expect(field).to_be_focused()
    page.keyboard.press("Enter")
    expect(cancel).to_be_focused()
    for key in ("Tab", "Tab", "Shift+Tab", "Enter"):
        page.keyboard.press(key)
    expect(page.locator("[data-review-done=good]")).to_contain_text("reads 88.0")
    assert state(site, 4)["setpoint"] == 880
    expect(field).to_be_focused()
    site.set_speed(4, value="89.0")
    expect(field).to_have_value("89.0")
    page.set_viewport_size({"width": 640, "height": 400})
    for key in ("8", "7", "Enter"):
        page.keyboard.press(key)
    expect(cancel).to_be_focused()
    page.keyboard.press("Enter")
    expect(field).to_be_focused()
    below = "field => field.getBoundingClientRect().top >= document.querySelector('.top').offsetHeight"
    assert field.evaluate(below)
    expect(field).to_be_in_viewport(ratio=1)


def test_a_setpoint_typed_before_the_scripts_are_there_stays(browser_page: OpensPages) -> None:
    page = browser_page(viewport=PANEL)

    def type_first(route: Route) -> None:
        page.locator("#setpoint").fill("87.0")
        route.continue_()

    page.route("**/setter.js*", type_first)
    opened(page, "/units/line/4")
    expect(page.locator("#setpoint")).to_have_value("87.0")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-act]")).to_have_text(re.compile(r"to 87\.0$"))


def test_a_review_ends_when_the_value_has_moved_or_the_unit_left_remote(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/6")
    page.locator("#setpoint").fill("66.0")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-act]")).to_be_visible()
    site.set_speed(6, value="50.0")
    expect(page.locator("[data-review-act]")).to_have_count(0)
    expect(page.locator("[data-review-end]")).to_contain_text("50.0")
    assert state(site, 6)["setpoint"] == 500
    expect(page.locator("#setpoint")).to_have_value("66.0")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-act]")).to_be_visible()
    site.line.remote.do("mode", unit=6, to="local")
    try:
        expect(page.locator("[data-review-end]").filter(has_text="left REMOTE")).to_be_attached()
        expect(page.locator("[data-review-act]")).to_have_count(0)
        expect(page.locator(".notice.by-mode__not")).to_be_visible()
        expect(page.locator("#setpoint")).to_be_hidden()
        expect(page.locator(".setting:focus")).to_have_count(1)
        expect(page.get_by_role("button", name="Switch output 1")).to_be_hidden()
        expect(page.locator('[hx-post$="/analog-output/review"]')).to_be_hidden()
    finally:
        site.line.remote.do("mode", unit=6, to="remote")
    expect(page.locator("#setpoint")).to_be_visible()
    expect(page.locator("[data-review-end]")).to_have_text(re.compile(r"^\d\d:\d\d:\d\d .*was sent\.$"))
    page.locator("#setpoint").fill("67.0")
    expect(page.locator("[data-review-end]")).to_have_count(0)


@pytest.mark.provokes("ERR_FAILED", "fetch")
def test_a_click_without_a_response_has_an_unknown_outcome(site: Site, browser_page: OpensPages) -> None:
    page = opened(browser_page(viewport=PANEL), "/units/line/6")
    before = site.writes()
    page.route("**/speed", lambda _: None)
    page.route("**/nudge", lambda route: route.abort())
    page.get_by_role("button", name="Set now").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-progress]")).to_be_visible()
    page.evaluate("document.dispatchEvent(new CustomEvent('lineside:lost'))")
    expect(page.locator("[data-review]")).to_have_count(0)
    expect(page.locator("[data-review-end]")).to_contain_text("result is not known")
    page.evaluate("document.dispatchEvent(new CustomEvent('lineside:found'))")
    page.locator(".nudges button").first.click()
    expect(page.locator("#setpoint-error")).to_contain_text("result is not known")
    assert site.writes() == before


@pytest.mark.soak
def test_a_review_lapses_after_half_a_minute(site: Site, browser_page: OpensPages) -> None:
    page = browser_page(viewport=PANEL)
    page.add_init_script(
        """const wait = setTimeout;
        window.setTimeout = (what, ms, ...more) => wait(what, ms === 30_000 ? 1000 : ms, ...more);"""
    )
    opened(page, "/units/line/3")
    before = site.writes()
    page.locator("#setpoint").fill("90.0")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-end]")).to_contain_text("30 s have passed. Nothing was sent.")
    expect(page.locator("[data-review]")).to_have_count(0)
    expect(page.locator("#setpoint")).to_have_value("90.0")
    assert site.writes() == before


@pytest.mark.soak
def test_paste_works_and_scrolling_changes_nothing(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/3")
    before = site.writes()
    field = page.locator("#setpoint")
    field.focus()
    page.evaluate(
        """() => {
        const carried = new DataTransfer();
        carried.setData("text/plain", " 92,5 ");
        const pasted = new ClipboardEvent("paste", {clipboardData: carried, bubbles: true, cancelable: true});
        if (document.activeElement.dispatchEvent(pasted)) document.execCommand("insertText", false, " 92,5 ");
    }"""
    )
    field.hover()
    page.mouse.wheel(0, 400)
    page.mouse.wheel(0, -400)
    for key in ("ArrowUp", "ArrowDown", "PageUp"):
        page.keyboard.press(key)
    expect(field).to_have_value(re.compile("92,5"))
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-act]")).to_have_text(re.compile(r"to 92\.5$"))
    page.get_by_role("button", name="Cancel").click()
    assert site.writes() == before


def test_by_touch_every_number_has_a_pad_that_names_it_and_its_limits(shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport={"width": 360, "height": 780}, has_touch=True), "/setpoints")
    field, pad = page.locator('[name="new-8"]'), page.locator(".keypad")
    field.tap()
    expect(pad).to_contain_text("0.0 to 200.0")
    assert field.get_attribute("inputmode") == "none", "the device's own keyboard would cover the pad"
    covered = "field => field.getBoundingClientRect().bottom > document.querySelector('.keypad').offsetTop"
    assert not field.evaluate(covered)
    for key in ("1", "0", "1", ".", "5", "erase", "7"):
        pad.locator(f'[data-pad="{key}"]').tap()
    expect(field).to_have_value("101.7")
    expect(field).to_be_focused()
    pad.get_by_role("button", name="Done").tap()
    expect(pad).to_be_hidden()
    page.locator("[data-together-tool]").select_option("offset")
    page.locator('[data-together="offset"]').tap()
    for key in ("5", "-"):
        pad.locator(f'[data-pad="{key}"]').tap()
    expect(page.locator('[data-together="offset"]')).to_have_value("-5")


def test_a_draft_of_setpoints_moves_no_row(shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    place = page.locator("[data-unit='line/1']").bounding_box()
    page.locator("[name=new-1]").fill("99")
    page.reload()
    expect(page.locator("[data-draft]")).to_be_visible()
    assert page.locator("[data-unit='line/1']").bounding_box() == place
    page.locator("[data-draft] button").click()


def test_what_is_typed_stays_while_something_else_is_done(site: Site, browser_page: OpensPages) -> None:
    was = state(site, 2)["setpoint"]
    page = opened(browser_page(viewport=PANEL), "/setpoints")
    page.locator("[name=new-1]").fill("999")
    page.get_by_role("button", name="Review the change").click()
    expect(page.locator("[name=new-1]")).to_have_attribute("aria-invalid", "true")
    site.set_speed(2, raw=was + 7, execute=False)
    page.get_by_role("button", name="Execute 1 staged").click()
    page.locator("#review [data-review-act]").click()
    expect(page.locator("#review")).to_be_hidden()
    expect(page.locator("[name=new-1]")).to_have_value("999")
    page = opened(page, "/units/line/3")
    page.locator("#setpoint").fill("42")
    page.get_by_role("button", name="Switch output 3").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("#outputs-result [data-review-done=good]")).to_be_visible()
    expect(page.locator("#setpoint")).to_have_value("42")


def test_a_draft_is_there_again_in_a_faceplate_that_is_opened_again(browser_page: OpensPages) -> None:
    page = opened(browser_page(viewport=PANEL), "/")
    for _ in range(2):
        page.locator('[data-unit="line/5"] [data-faceplate]').click()
        page.locator("#faceplate #setpoint").wait_for()
        if not page.evaluate("sessionStorage.getItem('lineside-drafts')"):
            page.locator("#faceplate #setpoint").fill("77")
            page.keyboard.press("Escape")
    expect(page.locator("#faceplate [data-draft]")).to_be_attached()
    expect(page.locator("#faceplate #setpoint")).to_have_value("77")


def test_a_value_for_one_parameter_of_many_units_is_no_draft_of_another(browser_page: OpensPages) -> None:
    page = opened(browser_page("engineer", viewport=PANEL), "/batch/line?number=6")
    page.locator("[name=unit-2]").fill("12.5")
    opened(page, "/batch/line?number=7")
    expect(page.locator("[name=unit-2]")).to_have_value("")
    opened(page, "/batch/line?number=6")
    expect(page.locator("[name=unit-2]")).to_have_value("12.5")


def test_a_refused_setpoint_is_marked_until_it_is_another_and_scrolls_no_row(
    shared_page: OpensPages,
) -> None:
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    field = page.locator("[name=new-1]")
    field.fill("999")
    page.get_by_role("button", name="Review the change").click()
    expect(field).to_have_attribute("aria-invalid", "true")
    assert page.evaluate("document.documentElement.scrollHeight - innerHeight") <= 0
    page.locator("#change-line [data-use]").click()
    expect(field).to_have_value("200.0")
    expect(field).to_have_attribute("aria-invalid", "false")
    expect(page.locator("#change-line")).to_be_empty()
    page.locator('[data-together-do="clear"]').click()


def test_discard_leaves_nothing_staged_while_an_input_stands_above_the_setpoint(
    site: Site, shared_page: OpensPages
) -> None:
    was = {unit: state(site, unit)["setpoint"] for unit in (1, 2)}
    for unit, input in ((1, "preset"), (2, "up")):
        site.line.remote.do("input", unit=unit, input=input, on=True)
    try:
        eventually(lambda: site.unit(1)["inputs"]["preset"] and site.unit(2)["inputs"]["up"], "the inputs")
        for unit in was:
            site.set_speed(unit, raw=was[unit] + 7, execute=False)
        page = opened(shared_page(viewport=PANEL), "/setpoints")
        expect(page.locator("#tray")).to_contain_text("Execute 2 staged")
        page.locator("#tray [hx-post$='/staged/discard']").click()
        expect(page.locator("#tray > *:visible")).to_have_count(0)
        with site.api("operator") as client:
            client.post("/buses/line/execute", json={}).raise_for_status()
        assert {unit: state(site, unit)["setpoint"] for unit in was} == was
    finally:
        for unit, input in ((1, "preset"), (2, "up")):
            site.line.remote.do("input", unit=unit, input=input, on=False)


def test_several_units_are_one_change_and_a_blocked_one_has_no_field(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    before = site.writes()
    former = [state(site, unit)["setpoint"] for unit in (3, 4)]
    for unit, text in ((3, "70.0"), (4, "71.0")):
        page.locator(f'[name="new-{unit}"]').fill(text)
    page.get_by_role("button", name="Review the change").click()
    act = page.get_by_role("button", name="Set 2 units now")
    # An older change of another unit may be offered where this one is over.
    undo = page.get_by_role("button", name="Undo: set the former setpoints")
    expect(act).to_be_visible()
    assert site.writes() == before
    act.click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("reads 71.0")
    assert (state(site, 3)["setpoint"], state(site, 4)["setpoint"]) == (700, 710)
    expect(page.locator("dialog[open]")).to_have_count(0)
    undo.click()
    expect(page.get_by_role("heading", name="Undo · Setpoints")).to_be_visible()
    site.set_speed(4, value="72.0")
    ended = page.locator("#change-line [data-review-end]")
    expect(ended).to_contain_text("Dryer 1: The value changed to 72.0")
    expect(undo).to_have_count(0)
    site.set_speed(4, value="71.0")
    page.reload()
    undo.click()
    act.click()
    expect(page.locator("[data-review-done=good]")).to_be_visible()
    assert [state(site, unit)["setpoint"] for unit in (3, 4)] == former
    page.keyboard.press("Escape")
    field = page.locator("[name=new-2]")
    expect(field).to_be_visible()
    with site.api("operator") as client:
        client.post("/buses/line/units/2/block", json={"reason": "belt off"}).raise_for_status()
        try:
            expect(field).to_be_hidden()
            expect(page.locator('[data-unit="line/2"] .by-block__why')).to_have_text(
                "commands blocked: belt off (operator-program)"
            )

            def others_selected() -> bool:
                page.get_by_role("button", name="Select all").click()
                return page.locator('[data-unit="line/1"] [data-tick]').is_checked()

            # A unit that is stale for a moment is left out, too.
            eventually(others_selected, "unit 1 selected", within=PAGE_S)
            expect(page.locator('[data-unit="line/2"] [data-tick]')).not_to_be_checked()
        finally:
            client.delete("/buses/line/units/2/block").raise_for_status()
    expect(field).to_be_visible()


@pytest.mark.soak
def test_scaling_fills_in_checked_rows(shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    commanded = float(page.locator('[data-live="line/2.commanded"]').inner_text())
    page.locator("tr[data-unit='line/2'] [data-tick]").check()
    page.locator('[data-together="scale"]').fill("50")
    page.locator('[data-together-do="enter"]').click()
    expect(page.locator('[name="new-2"]')).to_have_value(f"{commanded / 2:.1f}")
    expect(page.locator('[name="new-3"]')).to_have_value("")
    page.locator('[data-together-do="step"][data-by="+5"]').click()
    expect(page.locator('[name="new-2"]')).to_have_value(f"{commanded * 0.55:.1f}")
    page.locator("[data-together-tool]").select_option("offset")
    page.locator('[data-together="offset"]').fill("x")
    page.locator('[data-together-do="enter"]').click()
    expect(page.locator("#change-line")).to_contain_text("x is not a number")
    page.locator('[data-together="offset"]').fill("-999")
    page.locator('[data-together-do="enter"]').click()
    page.get_by_role("button", name="Review the change").click()
    expect(page.locator("#change-line")).to_contain_text("below 0")


def test_what_a_button_entered_is_kept_for_the_next_page_and_what_it_cleared_is_not(
    shared_page: OpensPages,
) -> None:
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    fields = [page.locator(f"[name=new-{unit}]") for unit in (1, 2)]
    fields[0].fill("50")
    page.locator("tr[data-unit='line/2'] [data-tick]").check()
    page.locator('[data-together-do="step"][data-by="+5"]').click()
    typed = [field.input_value() for field in fields]
    opened(page, "/setpoints")
    assert [field.input_value() for field in fields] == typed
    assert all(typed)
    draw = page.locator("[data-draw='line/1 line/2'] .draw-typed__new")
    expect(draw).to_contain_text("%")
    page.get_by_role("button", name="Discard draft").click()
    expect(page.locator(".setpoints__act :focus")).to_have_count(1)
    expect(draw).to_be_empty()
    assert [field.input_value() for field in fields] == ["", ""]
    page.locator("tr[data-unit='line/2'] [data-tick]").check()
    page.locator('[data-together-do="step"][data-by="+5"]').click()
    page.locator('[data-together-do="clear"]').click()
    opened(page, "/setpoints")
    assert [field.input_value() for field in fields] == ["", ""]


SEARCHES = """() => {
  let searches = 0;
  for (const name of ["querySelector", "querySelectorAll"]) {
    const search = document[name];
    document[name] = (selector) => { searches += 1; return search.call(document, selector); };
  }
  document.body.dispatchEvent(new Event("input", { bubbles: true }));
  delete document.querySelector;
  delete document.querySelectorAll;
  return searches;
}"""


def test_draws_are_shown_without_a_search_for_each_unit(shared_page: OpensPages) -> None:
    """With one for each of 255 units, the messages from them held the page up for good."""
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    assert page.evaluate(SEARCHES) < page.locator("[data-draw]").count()


def test_a_parameter_sent_without_a_response_is_no_draft(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page("engineer", viewport=PANEL), "/units/line/2/parameters")
    row = page.locator("#parameter-6")
    row.locator("[name=value]").fill("8.0")
    row.get_by_role("button", name="Write").click()
    page.locator("[data-review-act]").wait_for()
    try:
        site.line.remote.do("fault", kind="dead", rate=1, unit=2)
        page.locator("[data-review-act]").click()
        expect(page.locator("#parameters-result [data-review-done=unknown]")).to_be_visible()
        expect(row.locator("[data-draft]")).to_have_count(0)
        page.reload()
        expect(row.locator("[name=value]")).to_be_visible()
        expect(row.locator("[data-draft]")).to_have_count(0)
    finally:
        site.line.remote.do("clear")


def test_a_parameter_is_written_and_a_dangerous_one_wants_a_word(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page("engineer", viewport=PANEL), "/units/line/2/parameters")
    row = page.locator("#parameter-6")
    row.locator("[name=value]").fill("12.55")
    row.get_by_role("button", name="Write").click()
    expect(row.locator(".field__error")).to_contain_text("has 2 decimals")
    page.keyboard.press("Escape")
    expect(row.locator(".field__error")).to_have_count(0)
    row.get_by_role("button", name="Write").click()
    expect(row.locator(".field__error")).to_be_visible()
    page.locator("h1").click()
    expect(row.locator(".field__error")).to_have_count(0)
    expect(row.locator("[name=value]")).to_have_value("12.55")
    row.get_by_role("button", name="Write").click()
    row.get_by_role("button", name="Use 12.6").click()
    expect(row.locator("[name=value]")).to_have_value("12.6")
    row.locator("[name=value]").fill("12.5")
    expect(row.locator(".field__error")).to_have_count(0)
    row.get_by_role("button", name="Write").click()
    scrolled = page.evaluate("scrollY")
    page.locator("[data-review-act]").click()
    expect(page.locator("#parameters-result [data-review-done=good]")).to_contain_text("12.5")
    assert page.evaluate("scrollY") == scrolled
    expect(page.locator("dialog[open]")).to_have_count(0)
    expect(row).to_contain_text("125")
    assert site.line.remote.do("parameter", unit=2, number=6) == 125
    with site.api("engineer") as other:

        def write(raw: int) -> None:
            other.put("/buses/line/units/2/parameters/6", json={"raw": raw}).raise_for_status()

        write(130)
        row.locator("[name=value]").fill("12.0")
        row.get_by_role("button", name="Write").click()
        expect(page.locator("#parameter-6-value")).to_contain_text("13.0")
        write(140)
        page.locator("[data-review-act]").click()
        expect(page.locator("#parameters-result [data-review-done=bad]")).to_contain_text("it is 14.0 now")
        expect(page.locator("#parameter-6-value")).to_contain_text("14.0")
        expect(row.locator("[name=value]")).to_have_value("12.0")
        row.locator("[name=value]").fill("")
    before = site.writes()
    row = page.locator("#parameter-19")
    row.locator("[name=value]").select_option("Local")
    row.get_by_role("button", name="Write").click()
    act = page.locator("[data-review-act]")
    expect(act).to_be_disabled()
    page.locator("[data-typed]").fill("WRITE")
    expect(act).to_be_enabled()
    page.get_by_role("button", name="Cancel").click()
    assert site.writes() == before
