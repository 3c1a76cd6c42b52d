"""The journal of alarms as a page: filtered, and searched by the names that people use."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from app.alarms.alarm import state_text
from app.alarms.api import Alarms
from app.alarms.journal.store import JournalFilter
from app.alarms.monitor.line_alarms import LineAlarms
from app.alarms.rules.states import AlarmState
from app.alarms.summary import places_of, query_of
from app.messages import Language
from app.settings import Settings
from app.time_zone import day_begins
from app.web.admission.access import Viewer
from app.web.admission.turns import SEARCH
from app.web.rendering.templating import render, templates_of
from app.web.services import service_of
from bus.text import TypedText

router = APIRouter(include_in_schema=False)

ON_A_PAGE = 100
MAX_FOUND = 5000
"""Alarms that a search may find: their keys are values of one statement."""
AFTER: tuple[AlarmState, ...] = (
    "unack_active",
    "ack_active",
    "rtn_unack",
    "normal",
    "shelved",
    "suppressed",
    "out_of_service",
)
"""The states by which the journal is filtered."""
TypedFilter = Annotated[TypedText, Query(max_length=80)]


@router.get("/alarms/journal", dependencies=[SEARCH])
async def journal_page(
    request: Request,
    _: Viewer,
    alarms: Alarms,
    search: TypedFilter = "",
    place: TypedFilter = "",
    priority: TypedFilter = "",
    state: TypedFilter = "",
    day: TypedFilter = "",
    before: Annotated[int | None, Query(ge=1, le=2**62)] = None,
) -> Response:
    """The transitions that a person chose, newest first; ``day``: of the site."""
    zone = service_of(request, Settings).site.zone
    bus, _slash, unit = place.partition("/")
    chosen = {"search": search.strip(), "place": place, "priority": priority, "state": state, "day": day}
    found = JournalFilter(
        alarms=_named(alarms, chosen["search"], templates_of(request).language_of(request)),
        bus=bus or None,
        unit=int(unit) if unit.isascii() and unit.isdecimal() and len(unit) < 4 else None,
        priority=priority or None,
        after=state or None,
        start=day_begins(day, zone),
        end=day_begins(day, zone, timedelta(days=1)),
    )
    entries = await alarms.store.journal(
        ON_A_PAGE + 1, before, chosen=found if any(chosen.values()) else None
    )
    query = query_of(chosen)
    older = f"before={entries[ON_A_PAGE - 1].id}" if len(entries) > ON_A_PAGE else ""
    return render(
        request,
        "alarms/journal.html",
        transitions=entries[:ON_A_PAGE],
        place_of=alarms.place,
        chosen=chosen,
        states=[(each, state_text(each)) for each in AFTER],
        places=places_of(alarms),
        older="&".join(filter(None, (query, older))) if older else "",
        newest=query if before else None,
    )


def _named(alarms: LineAlarms, search: str, language: Language) -> list[str] | None:
    """The keys of the alarms whose place or name has each word of a search; None without one."""
    words = search.casefold().split()
    if not words:
        return None
    names: dict[str, str] = {}
    found: list[str] = []
    for alarm in alarms.every():
        definition = alarm.definition
        name = names.setdefault(str(definition.name), language.t(definition.name))
        text = f"{alarms.place(definition.bus, definition.unit)} {name}".casefold()
        if all(word in text for word in words):
            found.append(definition.key)
    return found[:MAX_FOUND]
