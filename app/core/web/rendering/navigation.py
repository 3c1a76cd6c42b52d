"""The pages of the site, in the order of the rail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bus.messages import Message

ON_PHONE = 4
"""Pages that a phone shows below; the others are one press away under *More*."""


@dataclass(frozen=True, slots=True)
class PageLines:
    """Which lines there are: ``has_several``, or a peer, so that there is a choice; ``has_own``, by a bus."""

    has_several: bool
    has_own: bool

    @property
    def is_overview(self) -> bool:
        """Whether this server shows only the lines of others."""
        return self.has_several and not self.has_own


class PageLink(NamedTuple):
    """``key``: what a template sets as ``here``; ``drawing``: in the icons; ``act``: what a person must be
    permitted to do."""

    key: str
    href: str
    drawing: str
    label: Message
    act: str = ""


OF_SERVER = frozenset(("lines", "alarms", "events", "configuration", "users"))
"""The pages of a server that shows only the lines of its peers."""
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


def pages_for(lines: PageLines, may: Callable[[str], bool]) -> list[PageLink]:
    """The pages of a person; ``may``: whether this person is permitted an act."""
    every: Sequence[PageLink] = (LINES, *PAGES) if lines.has_several else PAGES
    if lines.is_overview:
        every = [page for page in every if page.key in OF_SERVER]
    return [page for page in every if not page.act or may(page.act)]
