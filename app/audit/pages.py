"""The events page: who did what, filtered and searched, from a unit's page too."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import HTMLResponse

from app.audit.api import Events
from app.audit.events import groups
from app.audit.events.finding import units_named
from app.audit.events.store import Filter
from app.settings import Settings
from app.time_zone import day_begins
from app.web.admission.access import Viewer
from app.web.admission.turns import SEARCH
from app.web.api.shape import parse_integer
from app.web.rendering.formats import Formats
from app.web.rendering.templating import render, templates_of
from app.web.services import service_of
from bus.text import TypedText

router = APIRouter(include_in_schema=False)
ON_A_PAGE = 100
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
    """A form's empty fields do not narrow; the days are days at the site."""
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
    rows, after = await groups.page(events, wanted, ON_A_PAGE)
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
    """The query of the API for the same events: it takes instants."""
    names = ("kind", "bus", "unit", "who", "search")
    times = {"from": wanted.since, "to": wanted.until}
    instants = {name: None if at is None else formats.local(at).isoformat() for name, at in times.items()}
    return {name: getattr(wanted, name) for name in names} | instants
