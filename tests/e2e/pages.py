"""Pages in a browser that follow the line."""

from __future__ import annotations

from playwright.sync_api import Page, expect

LIVE = "body[data-link=live]"


def opened(page: Page, path: str) -> Page:
    """Open a page and wait until it follows the line."""
    page.goto(path)
    expect(page.locator(LIVE)).to_be_attached()
    return page
