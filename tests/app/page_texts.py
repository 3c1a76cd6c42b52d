"""The pages that a test walks through, and the texts of a page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser

PAGES = [
    *("/", "/?view=rows", "/?view=matrix", "/setpoints", "/line/zero", "/units/dry-end/1"),
    *("/units/dry-end/1/outputs/1", "/units/dry-end/1/parameters", "/units/dry-end/1/execute"),
    *("/units/dry-end/1/restore", "/units/dry-end/1/drift", "/units/dry-end/99", "/bus/dry-end"),
    *("/bus/dry-end/units", "/bus/dry-end/control", "/bus/dry-end/baud", "/trends", "/sets"),
    *("/sets/compare", "/batch/dry-end?parameter=6", "/swap/dry-end/1", "/recipes", "/users", "/account"),
    *("/users/the-admin/remove", "/events", "/login", "/offline", "/nowhere", "/system", "/help/legend"),
]
SHOWN = {"aria-label", "title", "placeholder", "alt"}
NO_TEXT = {"data-is", "data-live-var", "data-catalogue", "data-value-words"}
"""Names of fields, and JSON."""


class Texts(HTMLParser):
    """What a person reads of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self._hidden = 0
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._hidden += tag in ("script", "style")
        for name, value in attrs:
            if name in SHOWN or (name.startswith("data-") and name not in NO_TEXT and " " in (value or "")):
                self.found.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        self._hidden -= tag in ("script", "style")

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.found.append(data)


def texts_without(page: str, marked: re.Pattern[str]) -> Iterator[tuple[str, str]]:
    """Each text of a page, and what is left of it without all that is marked, also within what is marked."""
    for text in Texts(page).found:
        left = text
        while marked.search(left):
            left = marked.sub("", left)
        yield text, left
