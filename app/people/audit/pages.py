"""The events page: who did what, filtered and searched; and what the search of all pages finds of it."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import HTMLResponse

from app.core.find.finders import FoundPlace, Search, rank, words_of
from app.core.messages import Language
from app.core.time_zone import day_begins
from app.core.web.admission.access import Viewer
from app.core.web.admission.turns import SEARCH
from app.core.web.api.shape import parse_integer
from app.core.web.rendering.formats import Formats
from app.core.web.rendering.templating import render, templates_of
from app.core.web.services import service_of
from app.errors import StoreError
from app.people.audit.api import Events
from app.people.audit.entry import Event
from app.people.audit.log import EventLog
from app.people.audit.queries import Filter, UnitPlace
from app.settings import Settings
from bus.messages import Message
from bus.text import TypedText

router = APIRouter(include_in_schema=False)
ON_A_PAGE = 100
MAX_PARTS = 1000
"""Parts that one page holds; with more there are fewer rows on it. A change has at most 255."""
FIELDS = ("kind", "bus", "unit", "who", "since", "until", "search")


@router.get("/events", dependencies=[SEARCH])
async def events_page(
    request: Request,
    _: Viewer,
    events: Events,
    before: Annotated[str, Query(max_length=18)] = "",
    kind: str = "",
    bus: str = "",
    unit: Annotated[str, Query(max_length=3)] = "",
    who: TypedText = "",
    since: Annotated[str, Query(max_length=10)] = "",
    until: Annotated[str, Query(max_length=10)] = "",
    search: Annotated[TypedText, Query(max_length=200)] = "",
) -> HTMLResponse:
    """Show the events of a filter. Empty fields of its form do not narrow; days are those of the site."""
    chosen = dict(zip(FIELDS, (kind, bus, unit, who, since, until, search), strict=True))
    templates = templates_of(request)
    site_zone, formats = templates.site.zone, templates.formats(templates.language_of(request).tag)
    settings = service_of(request, Settings)
    wanted = Filter(
        before=parse_integer(before),
        kind=kind or None,
        bus=bus or None,
        unit=parse_integer(unit),
        who=who or None,
        since=day_begins(since, site_zone),
        until=day_begins(until, site_zone, timedelta(days=1)),
        search=formats.typed_number(search),
        named=units_named(settings, search),
    )
    rows, after = await page_of(events, wanted, ON_A_PAGE)
    return render(
        request,
        "events/page.html",
        rows=rows,
        names={(bus.name, unit.id): unit.name for bus in settings.bus for unit in bus.unit},
        kinds=await events.kinds(),
        chosen=chosen,
        older=_address("/events", chosen | {"before": after}) if after else "",
        newest=_address("/events", chosen) if before else "",
        csv=_address("/api/v1/events.csv", _of_api(wanted, formats)),
    )


def _address(path: str, query: dict[str, Any]) -> str:
    return f"{path}?" + urlencode({name: value for name, value in query.items() if value})


def _of_api(wanted: Filter, formats: Formats) -> dict[str, Any]:
    """Return the query of the API for the same events: it takes instants."""
    names = ("kind", "bus", "unit", "who", "search")
    times = {"from": wanted.since, "to": wanted.until}
    instants = {name: None if at is None else formats.local(at).isoformat() for name, at in times.items()}
    return {name: getattr(wanted, name) for name in names} | instants


@dataclass(frozen=True, slots=True)
class EventRow:
    """One row of the events page: an event, with the parts of a change of several units by address."""

    event: Event
    parts: list[Event] = field(default_factory=list)

    @property
    def outcomes(self) -> list[tuple[str | None, int]]:
        """How many parts have which outcome, the most frequent first; None while it is not known."""
        return Counter(part["outcome"] for part in self.parts).most_common()


async def page_of(events: EventLog, wanted: Filter, limit: int) -> tuple[list[EventRow], int | None]:
    """Return rows newest first, at most ``limit``, and the number to continue from (None at the end). A part
    is a row where the filter leaves its group out."""
    found, after = await events.page(replace(wanted, folded=True), limit)
    groups = sorted(event["id"] for event in found)
    parts, more = await events.page(Filter(parts_of=tuple(groups)), MAX_PARTS)
    by_group: dict[int, list[Event]] = {}
    for part in reversed(parts):
        by_group.setdefault(_group_of(part, groups), []).append(part)
    if more is not None:
        # Newest first: the change of the last part may have more than were read; newer ones have all.
        cut = _group_of(parts[-1], groups)
        found, after = [event for event in found if event["id"] > cut], cut + 1
    return [EventRow(event, by_group.get(event["id"], [])) for event in found], after


def _group_of(part: Event, ordered: Sequence[int]) -> int:
    """Return the number of the change that an event is a part of: its parts follow it."""
    return ordered[bisect_left(ordered, part["id"]) - 1]


SHOWN = 3
"""Events that are listed; the page of events has the others."""
MAX_SEARCHED = 10_000
"""A key press searches so many entries of the log: in a long one a word that is in none takes seconds."""
LAST = 100
"""Their rank: they come after everything that has the name."""


def units_named(settings: Settings, typed: str) -> tuple[UnitPlace, ...]:
    """Return the units with this name."""
    words = words_of(typed)
    if not words:
        return ()
    return tuple(
        (bus.name, unit.id)
        for bus in settings.bus
        for unit in bus.unit
        if rank(words, (unit.name, unit.group)) is not None
    )


class EventFinder:
    def __init__(self, events: EventLog, settings: Settings) -> None:
        self._events = events
        self._settings = settings
        self._names = {(bus.name, unit.id): unit.name for bus in settings.bus for unit in bus.unit}

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Return a way to the page of events with this search, and the newest of them."""
        typed = search.formats.typed_number(search.typed)
        named = units_named(self._settings, search.typed)
        wanted = Filter(search=typed, named=named, folded=True, newest=MAX_SEARCHED)
        try:
            events, _ = await self._events.page(wanted, SHOWN)
        except StoreError:
            events = []
        every = f"/events?{urlencode({'search': search.typed})}"
        more = FoundPlace(Message.of("find_events_with", text=search.typed), every, rank=LAST)
        return [
            *(
                FoundPlace(
                    self._label(event, search.language),
                    f"{every}#event-{event['id']}",
                    search.formats.moment(event["time"]) if event["time"] else "",
                    rank=LAST,
                )
                for event in events
            ),
            more,
        ]

    def _label(self, event: Event, language: Language) -> str:
        """Return what happened, after the name of the unit that it happened to."""
        what = language.t(event["messages"].get("what", event["what"]))
        name = self._names.get((event["bus"] or "", event["unit"] or 0))
        return f"{name} · {what}" if name else what
