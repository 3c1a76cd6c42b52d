"""The search of pages, actions and more that features add: a list below the field of each page, and a
page."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from app.core.find.finders import Finders, FixedPlace, Search
from app.core.web.access import Viewer
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import GROUPS, render, templates_of
from app.feature import Feature, Services
from bus.messages import Message
from bus.validation import OneLine

PAGE_WORDS = {
    "line": Message("find_words_line"),
    "alarms": Message("find_words_alarms"),
    "trends": Message("find_words_trends"),
    "shifts": Message("find_words_shifts"),
    "events": Message("find_words_events"),
    "bus": Message("find_words_bus"),
    "users": Message("find_words_users"),
    "configuration": Message("find_words_configuration"),
}
"""More words that find a page, by its ``key``."""
router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
Typed = Annotated[OneLine, Query(max_length=80)]
Near = Annotated[str, Query(max_length=200)]
ACTIONS = (
    # An address that begins with # is a press on the page itself: data-theme-toggle, data-clean.
    FixedPlace(Message("find_set_units"), "/setpoints", "SetLine", Message("find_words_setpoints")),
    FixedPlace(Message("find_zero"), "#press-zero", "SetLine", Message("find_words_zero")),
    FixedPlace(Message("find_save_recipe"), "/recipes", "save_recipe"),
    FixedPlace(Message("find_save_set"), "/sets", "save_parameter_set"),
    FixedPlace(Message("find_compare"), "/sets/compare", words=Message("find_words_compare")),
    FixedPlace(Message("find_export"), "/trends", words=Message("find_words_export")),
    FixedPlace(Message("find_write_note"), "/shifts/present", "write_shift_note"),
    FixedPlace(Message("find_add_alarm"), "/alarms/own", "add_own_alarm"),
    FixedPlace(Message("find_acknowledge"), "/alarms"),
    FixedPlace(Message("find_sound"), "/alarms#sound-title", words=Message("find_words_sound")),
    FixedPlace(Message("find_wallboard"), "/wallboard"),
    FixedPlace(Message("find_scan_bus"), "/bus#scan"),
    FixedPlace(Message("find_bus_load"), "/bus"),
    FixedPlace(Message("find_add_user"), "/users#add", "add_user"),
    FixedPlace(Message("find_change_password"), "/account", words=Message("find_words_account")),
    FixedPlace(Message("find_change_language"), "/account", words=Message("find_words_language")),
    FixedPlace(Message("find_backups"), "/system", words=Message("find_words_system")),
    FixedPlace(Message("find_theme"), "#theme-toggle", words=Message("find_words_theme")),
    FixedPlace(Message("find_full_screen"), "#full-screen"),
    FixedPlace(Message("find_clean_screen"), "#clean", words=Message("find_words_clean")),
    FixedPlace(Message("find_legend"), "/help/legend", words=Message("find_words_legend")),
    FixedPlace(Message("find_open_help"), "/help", words=Message("find_words_help")),
)


@router.get("/find", dependencies=[SEARCH])
async def find_page(
    request: Request, person: Viewer, typed: Typed = "", near: Near = "", part: bool = False
) -> Response:
    """Show the results for the typed text. ``part``: only the list."""
    templates = templates_of(request)
    language = templates.language_of(request)
    may = partial(templates.may, person)
    search = Search(typed, language, templates.formats(language.tag), may, near)
    found = await service_of(request, Finders).find(search)
    template = "find/_found.html" if part else "find/page.html"
    return render(request, template, typed=typed, near=near, found=found)


def make(services: Services) -> None:
    finders = services.add(Finders())
    pages = [
        FixedPlace(page.label, page.href, page.act, PAGE_WORDS.get(page.key))
        for group in GROUPS
        for page in group.pages
    ]
    finders.add_links("find_pages", pages)
    if services.demo:
        tour = FixedPlace(Message("find_tour"), "#tour", words=Message("find_words_tour"))
        finders.add_links("find_actions", [tour])
    finders.add_links("find_actions", ACTIONS)


FEATURE = Feature(make, (router,))
