"""Two buses on one site, with units of the same addresses: every text names the bus. And a follower."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import GERMAN, OpensPages
from tests.e2e.pages import PANEL, PHONE, count_shifts, opened, shifts
from tests.e2e.site import AT_REST, NO_TENSION_ALARM, Line, Site, eventually

NOT_RATIOED = 0
FOLLOWER = 1


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Three units on ``line``, two on ``wet``; unit 3 of ``line`` follows the first."""
    return line_server(3, line_options=AT_REST, more={"wet": 2}, toml=NO_TENSION_ALARM)


@pytest.fixture
def follower(site: Site) -> Iterator[int]:
    """Unit 3 of ``line`` as a follower that the server knows as one."""
    site.line.remote.do("parameter", unit=3, number=8, raw=FOLLOWER)
    site.line.remote.do("parameter", unit=3, number=31, raw=15000)
    site.line.remote.do("parameter", unit=3, number=38, raw=5000)
    read_again(site, 3)
    yield 3
    site.line.remote.do("parameter", unit=3, number=8, raw=NOT_RATIOED)
    read_again(site, 3)


def read_again(site: Site, unit: int) -> None:
    with site.api("engineer") as client:
        response = client.get(f"/buses/line/units/{unit}/parameters", params={"refresh": "true"})
    assert response.status_code == 200, response.text


def wet(site: Site) -> Line:
    return site.more["wet"][0]


def state(line: Line, unit: int) -> dict[str, Any]:
    found: dict[str, Any] = line.remote.do("state", unit=unit)
    return found


@pytest.mark.soak
def test_an_abnormal_unit_is_named_with_its_bus(site: Site, shared_page: OpensPages) -> None:
    """Both buses have a unit of that name."""
    with wet(site).stopped(2):
        page = opened(shared_page(viewport=PANEL), "/")
        expect(page.locator("h1")).to_contain_text("wet · Infeed nip · Stopped: emergency stop active")
        expect(page.locator(".top__alarm")).to_contain_text("to acknowledge")
        page.locator('[data-unit="wet/2"] [data-faceplate]').click()
        expect(page.locator("#faceplate-name")).to_have_text(re.compile(r"wet ·\s+Infeed nip"))
        overlap = """tile => {
          const box = part => tile.querySelector(part).getBoundingClientRect();
          return box(".value__number").bottom - box(".status").top;
        }"""
        assert page.locator('[data-unit="wet/2"]').first.evaluate(overlap) <= 0
        opened(page, "/units/wet/2")
        expect(page.locator("h1")).to_have_text(re.compile(r"wet · 2\s+Infeed nip"))
    expect(page.locator(".cause")).to_contain_text("At speed")


def test_a_speed_set_on_a_page_goes_to_its_bus_alone(site: Site, shared_page: OpensPages) -> None:
    before = state(site.line, 2)["setpoint"]
    page = opened(shared_page(viewport=PANEL), "/units/wet/2")
    page.locator("#setpoint").fill("71.5")
    page.get_by_role("button", name="Set now").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("71.5")
    assert (state(wet(site), 2)["setpoint"], state(site.line, 2)["setpoint"]) == (715, before)
    opened(page, "/")
    for unit, raw in (("wet/2", 715), ("line/2", before)):
        expect(page.locator(f'[data-live="{unit}.commanded"]')).to_have_text(re.compile(f"{raw / 10:.1f}"))


@pytest.mark.soak
def test_the_setpoints_page_has_both_and_changes_the_one_that_is_meant(
    site: Site, shared_page: OpensPages
) -> None:
    before = state(site.line, 1)["setpoint"]
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    form = page.get_by_role("form", name="wet")
    expect(form.get_by_role("heading", name="wet")).to_be_visible()
    form.locator('[name="new-1"]').fill("81.0")
    form.get_by_role("button", name="Review the change").click()
    expect(page.locator("#review-title")).to_contain_text("wet")
    page.get_by_role("button", name="Set 1 unit now").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("reads 81.0")
    assert (state(wet(site), 1)["setpoint"], state(site.line, 1)["setpoint"]) == (810, before)


def go_to_zero(page: Page) -> None:
    page.get_by_role("button", name="Set lines to zero").click()
    act = page.locator("[data-review-act]")
    expect(act).to_have_text("Set 2 lines to zero")
    act.click()


def test_zero_covers_both_with_a_result_for_each(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/trends")
    go_to_zero(page)
    done = page.locator("#tray-result [data-review-done=good]")
    expect(done).to_contain_text("line, wet · 5 units accepted speed 0")
    expect(page.locator("dialog[open]")).to_have_count(0)
    expect(done.locator("tbody th").filter(has_text="line ·")).to_have_count(3)
    expect(done.locator("tbody th").filter(has_text="wet ·")).to_have_count(2)
    assert {state(site.line, unit)["setpoint"] for unit in (1, 2, 3)} == {0}
    assert {state(wet(site), unit)["setpoint"] for unit in (1, 2)} == {0}


def test_a_review_of_zero_follows_what_its_units_can_take(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/trends")
    page.get_by_role("button", name="Set lines to zero").click()
    review, wet_box = page.locator("#review [data-review]"), page.get_by_role("checkbox", name="wet")
    wet_box.uncheck()
    expect(review).not_to_contain_text("left out")
    site.line.remote.do("mode", unit=2, to="local")
    try:
        expect(review).to_contain_text("left out: not in REMOTE")
        expect(page.get_by_role("checkbox", name="line")).to_be_checked()
        expect(wet_box).not_to_be_checked()
        expect(page.locator("[data-review-act]")).to_have_text("Set line line to zero")
    finally:
        site.line.remote.do("mode", unit=2, to="remote")
    expect(review).not_to_contain_text("left out")


def test_one_line_alone_is_set_to_zero(site: Site, shared_page: OpensPages) -> None:
    """Where its box is the only ticked one, by the keyboard, and from the page of one of its units."""
    for bus in ("line", "wet"):
        site.set_speed(1, bus=bus, value="50.0")
    page = opened(shared_page(viewport=PANEL), "/trends")
    page.get_by_role("button", name="Set lines to zero").press("Enter")
    expect(page.locator("[data-review-cancel]")).to_be_focused()
    act, box = page.locator("[data-review-act]"), page.get_by_role("checkbox", name="line")
    box.press("Space")
    expect(act).to_have_text("Set line wet to zero")
    page.get_by_role("checkbox", name="wet").press("Space")
    expect(act).to_have_text("No line is ticked")
    expect(act).to_be_disabled()
    box.press("Space")
    expect(act).to_have_text("Set line line to zero")
    act.press("Enter")
    expect(page.locator("[data-review-done=good]")).to_contain_text("line · 3 units accepted speed 0")
    assert (state(site.line, 1)["setpoint"], state(wet(site), 1)["setpoint"]) == (0, 500)

    site.set_speed(1, value="50.0")
    opened(page, "/units/wet/1")
    page.get_by_role("button", name="Set line wet to zero").click()
    expect(page.locator("#review-title")).to_have_text("Set line wet to zero")
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("wet · 2 units accepted speed 0")
    assert (state(site.line, 1)["setpoint"], state(wet(site), 1)["setpoint"]) == (500, 0)


@pytest.mark.soak
def test_zero_reaches_the_others_when_a_unit_refuses_the_stage(site: Site, shared_page: OpensPages) -> None:
    for bus in ("line", "wet"):
        site.set_speed(1, bus=bus, value="50.0")
    page = opened(shared_page(viewport=PANEL), "/")
    page.get_by_role("button", name="Set lines to zero").click()
    expect(page.locator("[data-review-act]")).to_be_visible()
    site.line.remote.do("fault", kind="nak", rate=1, unit=2)
    try:
        page.locator("[data-review-act]").click()
        done = page.locator("[data-review-done=bad]")
        expect(done).to_contain_text("4 of 5 units accepted speed 0")
        expect(done.locator("tbody tr").nth(1)).to_contain_text("rejected")
        assert (state(site.line, 1)["setpoint"], state(wet(site), 1)["setpoint"]) == (0, 0)
    finally:
        site.line.remote.do("clear")


@pytest.mark.soak
def test_a_closed_bus_leaves_the_other_its_controls(site: Site, shared_page: OpensPages) -> None:
    site.end_alarms()
    page = opened(shared_page(viewport=PANEL), "/")
    count_shifts(page, ".main", ("left", "top"))
    wet(site).remote.do("unplug")
    try:
        expect(page.locator("h1")).to_contain_text("wet · Port closed since")
        expect(page.locator("[data-live='line_summary.abnormal']")).to_have_text("2")
        expect(page.locator('[data-unit="wet/1"]')).not_to_have_attribute("data-quality", "online")
        expect(page.locator('[data-unit="line/1"]')).to_have_attribute("data-quality", "online")
        assert shifts(page) == []
        opened(page, "/setpoints")
        expect(page.locator(".top__verdict")).to_contain_text("wet · Port closed since")
        page.get_by_role("button", name="Set lines to zero").click()
        expect(page.locator("[data-review-act]")).to_have_text("Set line line to zero")
        expect(page.locator("#review-body")).to_contain_text("left out: port closed")
        page.locator("[data-review-act]").click()
        expect(page.locator("[data-review-done=bad]")).to_contain_text("3 of 5 units accepted speed 0")
    finally:
        wet(site).remote.do("plug")
    eventually(lambda: site.unit(1, "wet")["link"] == "online", "the bus back")


@pytest.mark.soak
def test_a_followers_setpoint_is_a_ratio(site: Site, shared_page: OpensPages, follower: int) -> None:
    page = opened(shared_page(viewport=PANEL), f"/units/line/{follower}")
    before = state(site.line, follower)["setpoint"]
    expect(page.locator("#set")).to_contain_text("Ratio")
    expect(page.locator(".plate__set")).to_contain_text("0.5000 to 1.5000")
    field = page.locator("#setpoint")
    expect(field).to_have_value(f"{before / 10_000:.4f}")
    field.fill("1.6")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("#setpoint-error")).to_contain_text("outside 0.5000 to 1.5000")
    page.get_by_role("button", name="Use 1.5000").click()
    expect(field).to_have_value("1.5000")
    field.fill("1,2345")
    page.get_by_role("button", name="Set now").click()
    page.get_by_role("button", name=re.compile(r"to 1\.2345$")).click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("verified: reads 1.2345")
    assert state(site.line, follower)["setpoint"] == 12345

    page.get_by_role("button", name=re.compile("Undo: set")).click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text(f"reads {before / 10_000:.4f}")
    expect(field).to_have_value(f"{before / 10_000:.4f}")

    page.get_by_role("button", name="Up by 0.0100").click()
    # The page may still have the words of the undo.
    eventually(lambda: state(site.line, follower)["setpoint"] == before + 100, "one step up")
    expect(page.locator("#setpoint-error")).to_contain_text("verified")
    expect(field).to_have_value(f"{(before + 100) / 10_000:.4f}")


@pytest.mark.soak
def test_all_lines_are_on_one_page_and_one_press_leads_to_one(
    shared_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    """By keyboard alone, on a phone, a panel and a wall, in both languages and by day and night."""
    page = opened(shared_page("viewer", viewport=PHONE, locale=GERMAN), "/")
    page.get_by_role("link", name="Linien", exact=True).press("Enter")
    expect(page.locator("h1")).to_have_text("Linien")
    expect(page.locator("[data-line]")).to_have_count(2)
    expect(page.locator("[data-line='line_of/wet'] .fleet__counts")).to_contain_text("2/2 aktuell")
    assert flaws(page, GERMAN) == []
    tile = page.get_by_role("link", name="wet", exact=True)
    tile.focus()
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(r"/\?bus=wet$"))
    expect(page.locator("#bus-wet")).to_be_visible()


@pytest.mark.soak
def test_a_tile_follows_its_line(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=PANEL), "/lines")
    tile = page.locator("[data-line='line_of/wet']")
    expect(tile).to_have_attribute("data-quality", "live")
    with wet(site).stopped(2):
        expect(tile).to_have_attribute("data-is", "urgent")
        expect(tile.locator(".fleet__text")).to_contain_text("emergency stop active")
        page.reload()
        expect(page.locator("[data-line]").first).to_have_attribute("data-line", "line_of/wet")
    expect(tile).not_to_have_attribute("data-is", "urgent")


def test_what_is_typed_for_one_bus_is_no_draft_of_the_other(shared_page: OpensPages) -> None:
    """Unit 1 is on both."""
    page = opened(shared_page(viewport=PANEL), "/setpoints")
    page.locator('[data-new="line/1"]').fill("77")
    page = opened(page, "/alarms")
    page = opened(page, "/setpoints")
    expect(page.locator('[data-new="line/1"]')).to_have_value("77")
    expect(page.locator('[data-new="wet/1"]')).to_have_value("")
    page.locator("[data-draft] button").click()
    expect(page.locator("[data-draft]")).to_have_count(0)
