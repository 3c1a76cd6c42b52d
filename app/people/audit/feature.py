"""The audit log as a feature: the page of events, the events that the search of all pages finds, and the
record of each start and end of the server."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import HTMLResponse

from app.core.database import Database
from app.core.database.migration import FIRST, Migration
from app.core.find.finders import Finders, FoundPlace, Search, rank, words_of
from app.core.messages import Language
from app.core.messages.languages import day_begins
from app.core.server.tls import ServerEvents
from app.core.web.access import Viewer
from app.core.web.formats import Formats
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.services import service_of
from app.core.web.shape import parse_integer
from app.core.web.templating import formats_of, render, templates_of
from app.errors import StoreError
from app.feature import Feature, Services
from app.people.audit import api
from app.people.audit.acts import ActLimit
from app.people.audit.anchor import Anchoring, anchor_file
from app.people.audit.api import Events
from app.people.audit.archive import EventArchive
from app.people.audit.entry import Event
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog, Filter, UnitPlace
from app.people.audit.proof import heads_of
from bus.instants import unix_now
from bus.messages import Message
from bus.settings import BusSettings
from bus.validation import TypedText

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
ON_A_PAGE = 100
MAX_PARTS = 1000
"""The most parts on one page; with more it has fewer rows. A change has at most 255 parts."""
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
    since: Annotated[TypedText, Query(max_length=20)] = "",
    until: Annotated[TypedText, Query(max_length=20)] = "",
    search: Annotated[TypedText, Query(max_length=200)] = "",
) -> HTMLResponse:
    """Show the events of a filter. Empty fields do not filter; days are those of the site."""
    chosen = dict(zip(FIELDS, (kind, bus, unit, who, since, until, search), strict=True))
    site_zone, formats = templates_of(request).site.zone, formats_of(request)
    finder = service_of(request, EventFinder)
    wanted = Filter(
        before=parse_integer(before),
        kind=kind or None,
        bus=bus or None,
        unit=parse_integer(unit),
        who=who or None,
        since=day_begins(formats.typed_time(since), site_zone),
        until=day_begins(formats.typed_time(until), site_zone, timedelta(days=1)),
        search=formats.typed_number(search),
        named=finder.units_named(search),
    )
    now, ends = unix_now(), ((since, wanted.since), (until, wanted.until))
    fault = next((formats.malformed_day(typed, now) for typed, at in ends if typed and at is None), None)
    chosen |= {
        name: formats.field_day(at)
        for name, at in (("since", wanted.since), ("until", wanted.until and wanted.until - 1))
        if at
    }
    rows, after = await page_of(events, wanted, ON_A_PAGE) if fault is None else ([], None)
    return render(
        request,
        "events/page.html",
        status=200 if fault is None else 422,
        fault=fault,
        rows=rows,
        names=finder.names,
        kinds=await events.kinds(),
        chosen=chosen,
        spans=[
            (text, _address("/events", chosen | {"since": first, "until": last}))
            for text, first, last in formats.recent_days(now)
        ],
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
    """A row of the events page: an event, with the parts of a change of several units by address."""

    event: Event
    parts: list[Event] = field(default_factory=list)

    @property
    def outcomes(self) -> list[tuple[str | None, int]]:
        """The number of parts with each outcome, the most frequent first; None while it is not known."""
        return Counter(part["outcome"] for part in self.parts).most_common()


async def page_of(events: EventLog, wanted: Filter, limit: int) -> tuple[list[EventRow], int | None]:
    """Return at most ``limit`` rows, newest first, and the number to continue from (None at the end). A part
    is a row of its own if the filter excludes its change. Pages follow the numbers; the rows of one follow
    the times shown, as a worker that was away reports late what happened before."""
    found, after = await events.page(replace(wanted, folded=True), limit)
    groups = sorted(event["id"] for event in found)
    parts, more = await events.page(Filter(parts_of=tuple(groups)), MAX_PARTS)
    by_group: dict[int, list[Event]] = {}
    for part in reversed(parts):
        by_group.setdefault(_group_of(part, groups), []).append(part)
    if more is not None:
        # Newest first: the change of the last part may have more parts than were read; newer ones have all.
        cut = _group_of(parts[-1], groups)
        found, after = [event for event in found if event["id"] > cut], cut + 1
    found = sorted(found, key=itemgetter("time", "id"), reverse=True)
    return [EventRow(event, by_group.get(event["id"], [])) for event in found], after


def _group_of(part: Event, ordered: Sequence[int]) -> int:
    """Return the number of the change that an event is a part of, which is the last one before it."""
    return ordered[bisect_left(ordered, part["id"]) - 1]


SHOWN = 3
"""The most events that the search lists; the page of events has the others."""
MAX_SEARCHED = 10_000
"""The most entries that a key press searches: a word that is in none would take seconds in a long log."""
LAST = 100
"""The rank of events, after everything found by name."""


class EventFinder:
    """The finder of events for the search of all pages, which also finds them by the names of units."""

    def __init__(self, events: EventLog, buses: Iterable[BusSettings]) -> None:
        self._events = events
        self._units = {(bus.name, unit.id): unit for bus in buses for unit in bus.unit}
        self.names = {place: unit.name for place, unit in self._units.items()}

    def units_named(self, typed: str) -> tuple[UnitPlace, ...]:
        """Return the units with this name."""
        words = words_of(typed)
        return tuple(
            place
            for place, unit in self._units.items()
            if words and rank(words, (unit.name, unit.group)) is not None
        )

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Return the newest events of a search, and the page of events with that search."""
        typed = search.formats.typed_number(search.typed)
        named = self.units_named(search.typed)
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
        """Return the text of an event, after the name of the unit."""
        what = language.t(event["messages"].get("what", event["what"]))
        name = self.names.get((event["bus"] or "", event["unit"] or 0))
        return f"{name} · {what}" if name else what


def make(services: Services) -> None:
    settings, database, lifespan = services.settings, services[Database], services.lifespan
    keys = open_keys(settings.key_files, database.path, database.read_now(heads_of))
    services.add(ActLimit())
    events = services.add(EventLog(database, keys=keys))
    services.add(events, ServerEvents)
    services[Finders].add("find_events", services.add(EventFinder(events, settings.bus)))
    anchor, is_configured = anchor_file(settings.audit, settings.key_files), settings.audit.anchor is not None
    anchoring = services.add(Anchoring(events, anchor, is_configured=is_configured))
    lifespan.add("audit anchor", anchoring.follow, end=anchoring.end)
    archive = EventArchive(
        database, events, settings.audit.archive, settings.audit.keep_months, ZoneInfo(settings.site.zone)
    )
    services.add(archive)
    lifespan.add("event archive", archive.follow)
    begin = partial(_record_start, settings.server.data, database.migrated, events)
    lifespan.add("event log", start=begin, end=partial(_record_end, events))
    lifespan.add("open commands", start=events.close_open_intents)
    record_all = partial(events.repeated.record_due, everything=True)
    lifespan.add("repeated events", events.repeated.follow, end=record_all)


async def _record_start(data: Path, migrated: Sequence[Migration], events: EventLog) -> None:
    """Record the state with which the server starts."""
    if migrated:
        await events.record(kind="server", what=_store_changed(migrated))
    await events.record(kind="server", what=Message("event_server_started"))
    if events.keys.path is not None and events.keys.path.is_relative_to(data):
        await events.record(kind="audit", what=Message("event_audit_key_in_data"))


async def _record_end(events: EventLog) -> None:
    await events.record(kind="server", what=Message("event_server_ended"))


def _store_changed(steps: Sequence[Migration]) -> Message:
    """Return the event of a store that was made or brought up to date."""
    if steps[0].number == FIRST:
        return Message("event_store_created")
    names = ", ".join(f"{step.number:04d} {step.name}" for step in steps)
    return Message.of("event_store_updated", steps=names)


FEATURE = Feature(make, (api.router, router))
