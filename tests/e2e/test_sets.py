"""Parameter sets, recipes, batch edit and unit swap as a person uses them."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.limits import PROCEDURE_MS, PROCEDURE_S
from tests.e2e.site import Site, eventually

OFFICE = {"width": 1280, "height": 900}
PHONE = {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Three units at rest, at ten times the baud rate, so that a reading of all parameters is soon over."""
    return line_server(3, line_options=("--no-script", "--speedup", "10"), ramp_s=20)


def writes(served: Site, command: int) -> list[dict[str, Any]]:
    entries = served.line.remote.do("record", kinds=["acted"])
    return [entry for entry in entries if bytes.fromhex(entry["hex"])[1] == command]


def take_set(page: Page) -> str:
    page.goto("/sets")
    page.get_by_role("button", name="Read units").click()
    page.get_by_label("Name", exact=True).fill("before the felt")
    page.get_by_role("button", name="Save set").click()
    page.get_by_role("link", name="Open the set").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("before the felt")
    return page.url


def of_unit(page: Page, name: str) -> Locator:
    """The part of a unit on the page of a set, opened."""
    part = page.locator("details.card", has_text=name)
    part.locator("summary").first.click()
    return part


@pytest.mark.soak
def test_a_set_is_taken_marked_golden_and_compared_with_the_unit_now(
    site: Site, shared_page: OpensPages
) -> None:
    page = shared_page("engineer", viewport=OFFICE)
    address = take_set(page)
    part = of_unit(page, "Unwind")
    expect(part.get_by_role("row", name=re.compile("Acceleration Ramp Rate"))).to_contain_text("20.0 s")
    part.get_by_role("button", name="Mark as golden set").click()
    expect(page.locator("summary", has_text="golden set")).to_have_count(1)
    with site.api("engineer") as client:
        response = client.put("/buses/line/units/1/parameters/6", json={"raw": 77})
        assert response.json()["outcome"] == "verified"
    page.goto(address)
    of_unit(page, "Unwind").get_by_role("link", name="Compare with the current values").click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("1 row differs")
    expect(page.get_by_text("accelerates in 7.7 s instead of 20.0 s")).to_be_visible()
    page.get_by_role("button", name="Restore Unwind to this set").click()
    expect(page.locator("#restore .outcome[role=status]")).to_contain_text("1 row would be written")


@pytest.mark.soak
def test_the_list_of_drift_is_redrawn_automatically_and_keeps_the_focus(
    site: Site, browser_page: OpensPages
) -> None:
    ramp = site.line.remote.do("parameter", unit=2, number=7)
    page = browser_page("engineer", viewport=PHONE)
    take_set(page)
    other = browser_page("engineer", viewport=OFFICE)
    other.goto("/units/line/2")
    expect(other.locator("#drift")).to_contain_text("This unit has no golden set.")
    of_unit(page, "Infeed nip").get_by_role("button", name="Mark as golden set").click()
    expect(other.locator("#drift")).to_contain_text("The unit equals the golden set, as last read.")
    restore = other.get_by_role("link", name="Restore parameters")
    restore.focus()
    site.line.remote.do("parameter", unit=2, number=7, raw=66)
    with site.api("engineer") as client:
        client.get("/buses/line/units/2/parameters", params={"refresh": "true"}).raise_for_status()
        expect(other.locator("#drift")).to_contain_text("changed at the keypad")
        expect(restore).to_be_focused()
        client.put("/buses/line/units/2/parameters/7", json={"raw": 67}).raise_for_status()
        expect(other.locator("#drift")).to_contain_text("changed by engineer-program")
        client.put("/buses/line/units/2/parameters/7", json={"raw": ramp}).raise_for_status()
    expect(other.locator("#drift")).to_contain_text("The unit equals the golden set, as last read.")
    expect(restore).to_be_focused()


@pytest.mark.soak
def test_a_change_of_baud_is_typed_and_every_unit_verified(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", viewport=OFFICE)
    page.goto("/bus/line")
    expect(page.locator("body[data-link=live]")).to_be_attached()
    page.get_by_label("New baud rate").select_option("4800")
    page.get_by_role("button", name="Review the change").click()
    verb = page.get_by_role("button", name="Change 3 units to 4800 baud")
    expect(verb).to_be_disabled()
    page.get_by_label(re.compile("Type BAUD")).fill("BAUD")
    verb.click()
    expect(page.locator("[data-review-done=good]")).to_be_visible(timeout=PROCEDURE_MS)
    with site.api("engineer") as client:
        assert client.post("/buses/line/baud", json={"baud": 2400}).json()["code"] == "dangerous"
    switch_off_and_on(site)
    expect(
        page.get_by_text("of the capacity of 4800 baud"), "shown, and not only when loaded"
    ).to_be_attached()
    page.goto("/bus/line")
    expect(page.locator("body[data-link=live]")).to_be_attached()
    expect(page.get_by_text("of the capacity of 4800 baud")).to_be_visible()
    page.get_by_label("New baud rate").select_option("9600")
    page.get_by_role("button", name="Review the change").click()
    page.get_by_label(re.compile("Type BAUD")).fill("BAUD")
    page.get_by_role("button", name="Change 3 units to 9600 baud").click()
    expect(page.locator("[data-review-done=good]")).to_be_visible(timeout=PROCEDURE_MS)
    switch_off_and_on(site)


def switch_off_and_on(served: Site) -> None:
    """The new rate applies from the next power-up; the host follows automatically."""
    for unit in (1, 2, 3):
        served.line.remote.do("power_cycle", unit=unit)
    off = datetime.now(UTC)
    eventually(
        lambda: all(responded_since(served, unit, off) for unit in (1, 2, 3)),
        "every unit at the new rate",
        within=PROCEDURE_S,
    )


def responded_since(served: Site, number: int, moment: datetime) -> bool:
    unit = served.unit(number)
    return bool(
        unit["link"] == "online" and datetime.fromisoformat(unit["read_at"]) > moment + timedelta(seconds=1)
    )


def test_a_recipe_is_saved_tried_out_and_loaded_as_one_change(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", viewport=OFFICE)
    page.goto("/recipes")
    page.get_by_role("button", name="as a recipe").click()
    page.get_by_label("Name of the product").fill("Kraft 80")
    for name, value in (("Unwind", "100,0"), ("Infeed nip", "1O0.5"), ("Coater", "101.0")):
        page.get_by_label(name, exact=True).fill(value)
    page.get_by_role("button", name="Save as a recipe").click()
    wrong = page.get_by_label("Infeed nip", exact=True)
    expect(wrong).to_have_attribute("aria-invalid", "true")
    expect(page.get_by_label("Name of the product")).to_have_value("Kraft 80")
    wrong.fill("100.5")
    page.get_by_role("button", name="Save as a recipe").click()
    expect(page.get_by_role("heading", level=1)).to_contain_text("Kraft 80")
    staged, executed = len(writes(site, 0x82)), len(writes(site, 0x83))
    page.get_by_role("button", name="Load Kraft 80").click()
    expect(page.locator("#review")).to_be_visible()
    assert len(writes(site, 0x82)) == staged
    page.get_by_role("button", name="Set 3 units to Kraft 80").click()
    done = page.locator("[data-review-done=good]")
    expect(done.locator("tbody tr").nth(1)).to_contain_text("Infeed nip")
    expect(done.locator("tbody tr").nth(1)).to_contain_text("verified: reads 100.5")
    # A request that got no response in time is repeated.
    assert {write["unit"] for write in writes(site, 0x82)[staged:]} == {1, 2, 3}
    assert {write["unit"] for write in writes(site, 0x83)[executed:]} == {1, 2, 3}
    assert [site.unit(number)["commanded_raw"] for number in (1, 2, 3)] == [1000, 1005, 1010]
    page.goto("/recipes")
    expect(page.get_by_text("Every unit still has the setpoint of the recipe.")).to_be_visible()


def test_one_parameter_over_many_units(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", viewport=OFFICE)
    page.goto("/batch/line?number=12")
    before = len(writes(site, 0x86))
    page.get_by_label("New value for Unwind").fill("2.5")
    page.get_by_label("New value for Coater").fill("3.5")
    page.get_by_role("button", name="Review").click()
    expect(page.locator("#review")).to_contain_text("2.5")
    assert len(writes(site, 0x86)) == before
    page.get_by_role("button", name=re.compile("Write Up to Speed Tolerance to 2 units")).click()
    strip = page.locator("#batch-result")
    expect(strip).to_contain_text("2 of 2 units verified")
    expect(page.locator("#review")).to_be_hidden()
    assert len(writes(site, 0x86)) == before + 2
    unwind = page.locator("#batch-rows tr", has_text="Unwind")
    expect(unwind).to_contain_text("2.5")
    expect(unwind.get_by_role("textbox")).to_have_value("")
    elsewhere = page.request.get(f"{site.url}/bus/line/undo").text()
    assert "Up to Speed" not in elsewhere, "the undo of one of two units"
    strip.get_by_role("button", name="Undo: write the former values").click()
    page.get_by_role("button", name=re.compile("Write Up to Speed Tolerance to 2 units")).click()
    expect(unwind).not_to_contain_text("2.5")
    expect(strip).to_contain_text("2 of 2 units verified")


@pytest.mark.soak
def test_golden_sets_of_the_line_are_saved_after_a_review(site: Site, shared_page: OpensPages) -> None:
    assert site.units == 3
    page = shared_page("engineer", viewport=PHONE)
    page.goto("/sets")
    page.get_by_role("button", name="Save golden sets of 3 units…").click()
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.get_by_role("button", name="Save golden sets of 3 units", exact=True).click()
    rows = page.get_by_role("table").locator("tbody tr")
    expect(rows).to_have_count(3)
    expect(rows.filter(has_text="golden set")).to_have_count(3, timeout=PROCEDURE_MS)
    expect(page.get_by_text("120 of 120 values read")).to_be_visible()
    page.get_by_role("link", name="Open the set").click()
    expect(page.locator("summary", has_text="golden set")).to_have_count(3)
