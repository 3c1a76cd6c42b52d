"""The pages of the site, in the order of the rail."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bus.messages import Message

ON_PHONE = 4
"""Pages that a phone shows below; the others are one press away under *More*."""


class PageLink(NamedTuple):
    """``key``: what a template sets as ``here``; ``drawing``: in the icons; ``act``: what a person must be
    permitted to do."""

    key: str
    href: str
    drawing: str
    label: Message
    act: str = ""


LINES = PageLink("lines", "/lines", "dense", Message("page_lines"))
"""Only where there are several."""
PAGES = (
    PageLink("line", "/", "line", Message("page_line")),
    PageLink("alarms", "/alarms", "urgent", Message("page_alarms")),
    PageLink("shifts", "/shifts", "clock", Message("page_shifts")),
    PageLink("setpoints", "/setpoints", "setpoints", Message("page_setpoints")),
    PageLink("trends", "/trends", "trends", Message("page_trends")),
    PageLink("events", "/events", "events", Message("page_events")),
    PageLink("recipes", "/recipes", "recipes", Message("page_recipes")),
    PageLink("sets", "/sets", "sets", Message("page_sets")),
    PageLink("bus", "/bus", "bus", Message("page_bus")),
    PageLink(
        "configuration", "/configuration", "edit", Message("page_configuration"), "change_configuration"
    ),
    PageLink("users", "/users", "users", Message("page_users"), "add_user"),
)


HELP = {
    "line": "operator#the-line",
    "unit": "operator#a-unit",
    "setpoints": "operator#several-units-at-once",
    "alarms": "operator#alarms",
    "shifts": "operator#the-shift",
    "trends": "operator#trends",
    "events": "operator#events",
    "recipes": "recipes",
    "sets": "replace-a-drive",
    "bus": "hardware",
    "users": "users",
    "configuration": "configuration",
    "lines": "several-lines",
}
"""The chapter of the help that is about a page, by its ``key``; of all others the list of chapters."""


def pages_for(has_lines: bool, may: Callable[[str], bool]) -> list[PageLink]:
    """The pages of a person; ``may``: whether this person is permitted an act."""
    every = (LINES, *PAGES) if has_lines else PAGES
    return [page for page in every if not page.act or may(page.act)]
