"""A shift is handed over on a phone: a note, its correction, two signatures, the file. About 10 s."""

from __future__ import annotations

from collections.abc import Callable

from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.site import PASSWORD


def test_a_shift_is_handed_over(browser_page: OpensPages, axe: Callable[[Page], list[str]]) -> None:
    page = browser_page("operator", viewport={"width": 360, "height": 740})
    page.goto("/shifts/present")
    page.get_by_label("Text", exact=True).focus()
    page.keyboard.type("Felt changed")
    page.get_by_label("Unit", exact=True).select_option(label="line · Infeed nip")
    page.get_by_role("button", name="Store note").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#note-1")).to_contain_text("Felt changed")
    expect(page.locator("#note-1")).to_contain_text("operator · Infeed nip")
    page.get_by_role("link", name="Correct note 1").click()
    page.get_by_label("Text", exact=True).fill("Wire changed")
    page.get_by_role("button", name="Store correction").click()
    expect(page.locator("#note-1")).to_contain_text("Corrected by note 2.")

    page.goto("/shifts")
    page.locator("tbody a").nth(1).click()
    page.get_by_role("button", name="Hand over shift: operator").click()
    page.get_by_label("Name", exact=True).fill("engineer")
    page.get_by_label("Password", exact=True).fill(PASSWORD)
    page.keyboard.press("Enter")
    expect(page.locator("section:has(#signatures)")).to_contain_text("engineer")
    expect(page.get_by_role("button", name="Take over shift")).to_have_count(0)
    assert axe(page) == []
    with page.expect_download() as download:
        page.get_by_role("link", name="Download as HTML").click()
    assert download.value.suggested_filename.endswith(".html")
    assert "<b>engineer</b>" in download.value.path().read_text(encoding="utf-8")
