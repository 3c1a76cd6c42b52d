"""Nothing on the pages that set a speed moves while a command is on its way, is over, or an alarm comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.limits import UNIT_MS
from tests.e2e.pages import PANEL, PHONE, count_shifts, opened, shifts
from tests.e2e.site import Site, eventually
from tests.sizes import in_turn

UNIT = 3
END_UNDO = (
    "() => { for (const until of document.querySelectorAll('[data-until]')) until.dataset.until = '0'; }"
)
LOSE_UNIT = """() => {
  document.querySelector(".plate").dataset.quality = "offline";
  document.querySelector(".ladder").dataset.is = "link high";
  return document.querySelector(".cause__replace").checkVisibility();
}"""
"""What a unit that stops responding changes on its page, without the seconds until it is found so; returns
whether the way to replace it shows."""


@pytest.fixture
def faults(site: Site) -> Iterator[Callable[..., Any]]:
    """Operate the simulated units; at the end each is as before."""
    yield site.line.remote.do
    for unit in range(1, 9):
        site.line.remote.do("input", unit=unit, input="estop", on=False)
        site.line.remote.do("mode", unit=unit, to="remote")


def changed(text: str, by: float) -> str:
    """A setpoint as it is typed, in the language of the page."""
    number = f"{float(text.replace(',', '.')) + by:.1f}"
    return number.replace(".", ",") if "," in text else number


def drawn(page: Page) -> None:
    """Wait until what has changed is drawn."""
    page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => setTimeout(drawn, 50)))")


def no_shift(page: Page, step: str) -> None:
    drawn(page)
    assert shifts(page) == [], step


@pytest.mark.parametrize(
    ("size", "locale"),
    in_turn((PANEL, PHONE), (ENGLISH, GERMAN), first=1),
)
def test_nothing_on_a_unit_moves_for_a_command_its_result_its_undo_or_an_alarm(
    shared_page: OpensPages, faults: Callable[..., Any], size: Any, locale: str
) -> None:
    page = opened(shared_page("engineer", viewport=size, locale=locale), f"/units/line/{UNIT}")
    count_shifts(page, "main")
    field = page.locator("#setpoint")
    expect(field).not_to_have_value("")

    def send(value: str, opens: str) -> None:
        field.fill(value)
        page.locator(opens).click()
        page.locator("[data-review-act]").wait_for()
        no_shift(page, f"the review by {opens}")
        page.locator("[data-review-act]").click()
        expect(page.locator("#setpoint-error [data-review-done]")).to_be_visible(timeout=UNIT_MS)
        no_shift(page, f"the result by {opens}")

    was = field.input_value()
    send(changed(was, 1.5), ".setter__now")
    page.locator("#setpoint-error [data-undo] button").click()
    page.locator("[data-review-act]").wait_for()
    no_shift(page, "the review of the undo")
    page.locator("[data-review-act]").click()
    expect(field).to_have_value(was, timeout=UNIT_MS)
    no_shift(page, "the result of the undo")
    page.evaluate(END_UNDO)
    expect(page.locator("[data-undo]:visible")).to_have_count(0)
    no_shift(page, "the end of the undo")
    field.fill("99999")
    page.locator(".setter__now").click()
    page.locator("#setpoint-error [data-use]").wait_for()
    no_shift(page, "a refusal")
    send(changed(was, 0.9), ".setter__stage")
    page.locator(".staged button").click()
    page.locator("[data-review-act]").wait_for()
    page.locator("[data-review-act]").click()
    expect(field).to_have_value(changed(was, 0.9), timeout=UNIT_MS)
    no_shift(page, "the executed stage")
    page.locator("button.outputs__item >> nth=0").click()
    page.locator("#outputs-review [data-review-act]").wait_for()
    no_shift(page, "the review of an output")
    page.locator("#outputs-review [data-review-act]").click()
    expect(page.locator("#outputs-result [data-review-done]")).to_be_visible(timeout=UNIT_MS)
    no_shift(page, "the result of an output")
    faults("input", unit=UNIT, input="estop", on=True)
    expect(page.locator(".ladder")).to_have_attribute("data-is", "e-stop urgent")
    no_shift(page, "an alarm")
    faults("mode", unit=UNIT, to="local")
    expect(page.locator(".setting")).to_have_attribute("data-is", "local")
    no_shift(page, "LOCAL")
    page.set_viewport_size(PHONE)
    drawn(page)  # in its new size, whose own moves are none of the unit's
    count_shifts(page, "main")
    assert page.evaluate(LOSE_UNIT)
    no_shift(page, "a unit that does not respond")


def test_a_phone_is_not_scrolled_under_the_thumb_by_the_result_of_a_nudge(shared_page: OpensPages) -> None:
    page = opened(shared_page("engineer", viewport=PHONE, locale=GERMAN), f"/units/line/{UNIT}")
    page.locator(".plate__dock a").click()
    up = page.locator(".nudges button >> nth=1")
    place = up.bounding_box()
    for nudge in (up, page.locator(".nudges button >> nth=2")):
        nudge.click()
        expect(page.locator("#setpoint-error [data-review-done=good]")).to_be_in_viewport(
            ratio=1, timeout=UNIT_MS
        )
        assert up.bounding_box() == place
        page.evaluate("() => document.getElementById('setpoint-error').replaceChildren()")


def stage(site: Site, by: float) -> dict[int, str]:
    """Stage a speed in three units; what each is commanded now."""
    was = {unit: site.unit(unit)["commanded"] for unit in (1, 2, 3)}
    for unit, commanded in was.items():
        site.set_speed(unit, value=changed(commanded, by), execute=False)
    return was


@pytest.mark.parametrize(("size", "locale"), in_turn((PHONE, PANEL), (GERMAN, ENGLISH), first=1))
def test_no_row_of_the_setpoints_moves_for_a_change_what_is_staged_or_an_alarm(
    site: Site, shared_page: OpensPages, faults: Callable[..., Any], size: Any, locale: str
) -> None:
    page = opened(shared_page("engineer", viewport=size, locale=locale), "/setpoints")
    count_shifts(page, "main")
    result = page.locator("#change-line [data-review-done=good]")
    was = {unit: site.unit(unit)["commanded"] for unit in (1, 2, 3)}
    for unit, commanded in was.items():
        text = changed(commanded, 0.6)
        page.locator(f"[name=new-{unit}]").fill(text.replace(".", ",") if locale == GERMAN else text)
    expect(page.locator("[data-draw='line/1 line/2'] .draw-typed__new")).to_contain_text("%")
    no_shift(page, "typed values")
    page.locator(".setpoints__act [type=submit]").click()
    page.locator("[data-review-act]").wait_for()
    page.locator("[data-review-act]").click()
    expect(result).to_be_visible(timeout=UNIT_MS)
    expect(page.locator("[name=new-1]")).to_have_value("")
    expect(result.locator("[data-undo] button")).to_be_visible()
    no_shift(page, "the result")
    page.evaluate(END_UNDO)
    expect(page.locator("[data-undo]:visible")).to_have_count(0)

    foot = page.locator(".setpoints__act")
    place = foot.bounding_box()
    stage(site, 0.3)
    execute = page.locator("#tray [hx-get$='/staged/review']")
    expect(execute).to_contain_text("3")
    expect(page.locator(".staged-mark:visible")).to_have_count(3)
    no_shift(page, "three staged setpoints")
    assert foot.bounding_box() == place
    page.locator("#tray [hx-post$='/staged/discard']").click()
    expect(page.locator(".staged-mark:visible")).to_have_count(0, timeout=UNIT_MS)
    expect(page.locator("#tray > *:visible")).to_have_count(0)
    no_shift(page, "discarded")

    before = stage(site, -0.6)
    expect(execute).to_contain_text("3")
    page.locator("#tray [hx-get$='/staged/review']").click()
    page.locator("[data-review-act]").wait_for()
    page.locator("[data-review-act]").click()
    then = {unit: changed(commanded, -0.6) for unit, commanded in before.items()}
    eventually(lambda: {unit: site.unit(unit)["commanded"] for unit in then} == then, "they are executed")
    expect(page.locator("[data-review]")).to_have_count(0)
    expect(result.locator("[data-undo] button")).to_be_visible()
    no_shift(page, "executed")
    faults("input", unit=2, input="estop", on=True)
    faults("mode", unit=5, to="local")
    expect(page.locator("[data-unit='line/5'] .by-mode__not")).to_be_visible()
    cause = page.locator("[data-unit='line/2'] .setpoints__state > .status")
    expect(cause.and_(page.locator("[data-is=urgent]"))).to_be_visible(timeout=UNIT_MS)
    no_shift(page, "an alarm and LOCAL")
    with site.api("engineer") as client:
        client.post("/buses/line/units/7/block", json={"reason": "belt off, do not run"}).raise_for_status()
        expect(page.locator("[data-unit='line/7'] .setpoints__entry > .mark")).to_be_visible(timeout=UNIT_MS)
        no_shift(page, "a block")
        client.delete("/buses/line/units/7/block").raise_for_status()
