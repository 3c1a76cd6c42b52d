"""A shift is handed over on a phone: a note with a picture, its correction, two signatures, a file. 20 s."""

from __future__ import annotations

import re
from collections.abc import Callable
from struct import pack
from zlib import compress, crc32

import pytest
from playwright.sync_api import Page, expect

from app.records.handover.rules import exif_of
from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.pages import PHONE
from tests.e2e.site import PASSWORD

MAX_SCREENS, MAX_PAPER = 12, 2


def png(width: int, height: int, more: bytes = b"") -> bytes:
    """A gray picture; ``more``: Exif data."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return pack(">I", len(data)) + kind + data + pack(">I", crc32(kind + data))

    header = chunk(b"IHDR", pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    rows = compress((b"\0" + b"\x80" * width) * height)
    exif = chunk(b"eXIf", more) if more else b""
    return b"\x89PNG\r\n\x1a\n" + header + exif + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def own(page: Page) -> dict[str, str]:
    """The header of a request that a page of this site sends."""
    return {"Origin": page.url.partition("/shifts")[0]}


@pytest.mark.soak
def test_a_shift_is_handed_over(browser_page: OpensPages, flaws: Callable[..., list[str]]) -> None:
    page = browser_page("operator", viewport=PHONE)
    page.goto("/shifts/present")
    expect(page.locator(".sheet-verdict")).to_be_in_viewport()
    page.get_by_role("link", name="Write note").click()
    page.get_by_label("Text", exact=True).focus()
    page.keyboard.type("Felt changed")
    page.get_by_label("Unit", exact=True).select_option(label="line · Infeed nip")
    picture = {"name": "felt.png", "mimeType": "image/png", "buffer": png(3000, 2000)}
    page.get_by_label("Pictures", exact=True).set_input_files([picture])
    expect(page.locator("[data-chosen]")).to_have_text(re.compile(r"^felt\.png · [\d.]+ kB$"))
    expect(page.get_by_role("button", name="Store note")).to_be_enabled()
    page.get_by_role("button", name="Store note").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#note-1")).to_contain_text("Felt changed")
    expect(page.locator("#note-1")).to_contain_text("operator · Infeed nip")
    shown = page.locator("#note-1 img")
    shown.scroll_into_view_if_needed()
    expect(shown).to_have_js_property("naturalWidth", 1600)
    page.get_by_role("link", name="Write note").click()
    expect(page.get_by_label("Text", exact=True)).to_have_value("")
    page.get_by_label("Text", exact=True).fill("About the shift")
    for place, text in (("line/2", ""), ("line/3", ""), ("line/2", "About line/2")):
        page.goto(f"/shifts/present?place={place}")
        expect(page.get_by_label("Text", exact=True)).to_have_value(text)
        expect(page.get_by_label("Unit", exact=True)).to_have_value(place)
        page.get_by_label("Text", exact=True).fill(f"About {place}")
    page.goto("/shifts/present")
    page.get_by_role("link", name="Correct note 1").click()
    page.get_by_label("Text", exact=True).fill("Wire changed")
    page.get_by_role("button", name="Store correction").click()
    expect(page.locator("#note-1")).to_contain_text("Corrected by note 2.")

    # Without the page's script, from a camera that was held upright.
    picture = {"name": "felt.png", "mimeType": "image/png", "buffer": png(60, 40, exif_of(6))}
    address = f"{page.url.partition('#')[0]}/notes"
    form = {"text": "Dryer", "pictures": picture}
    page.request.post(f"{address}", multipart=form, headers=own(page))
    page.goto("/shifts/present#note-3")
    shown = page.locator("#note-3 img")
    shown.scroll_into_view_if_needed()
    expect(shown).to_have_js_property("naturalWidth", 40)

    page.goto("/shifts")
    # The newest ones without a record are not in the list.
    page.get_by_role("link", name="Older shifts").click()
    page.locator("tbody a").first.click()
    page.get_by_role("button", name="Hand over shift: operator").click()
    expect(page.get_by_role("button", name="Take over shift").first).to_be_visible()
    page.get_by_label("Name", exact=True).fill("engineer")
    page.get_by_label("Password", exact=True).fill(PASSWORD)
    page.keyboard.press("Enter")
    expect(page.locator("section:has(#signatures)")).to_contain_text("engineer")
    expect(page.get_by_role("button", name="Take over shift")).to_have_count(0)
    signed = page.url.partition("#")[0]
    with page.expect_download() as download:
        page.get_by_role("link", name="Download as HTML").click()
    assert download.value.suggested_filename.endswith(".html")
    assert "<b>engineer</b>" in download.value.path().read_text(encoding="utf-8")

    paper = re.findall(rb"/Type */Page[^s]", page.pdf(prefer_css_page_size=True))
    assert len(paper) <= MAX_PAPER, "of a quiet shift"

    # The open sheet with its pictures, the signed one, and the list with the signatures.
    open_sheet, every = "/shifts/present", "/shifts"
    for locale, language, paths in (
        (ENGLISH, "en", (open_sheet, every)),
        (GERMAN, "de", (open_sheet, signed)),
    ):
        page.request.post("/account/language", form={"language": language}, headers=own(page))
        for path in paths:
            page.set_viewport_size(PHONE)
            page.goto(path)
            expect(page.locator(f"html[lang^={language}] body[data-link=live]")).to_be_attached()
            expect(page.locator(".rail__item[aria-current]:visible")).to_be_in_viewport(ratio=1)
            assert flaws(page, locale) == [], path
            page.set_viewport_size(PHONE)
            assert page.evaluate("document.documentElement.scrollHeight / innerHeight") <= MAX_SCREENS
