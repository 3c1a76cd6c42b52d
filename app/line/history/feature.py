"""The trends page, and its saved views, of one person or shared with all. The address of the page holds its
content, so that a link reopens the same view."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any
from urllib.parse import parse_qsl, urlencode

from fastapi import APIRouter, Form, Path
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.database import Database, StoreConnection
from app.core.database.connection import upsert
from app.core.web.access import Person, Role, Viewer
from app.core.web.routes import GuardedRoute
from app.core.web.services import service
from app.core.web.templating import render, templates_of
from app.errors import Problem, StoreError
from app.feature import Feature, Services
from app.line.history import api
from app.line.history.api import HistoryOf
from app.line.history.export import has_parquet
from app.line.history.series import values
from app.line.history.series.values import VALUES
from app.line.history.service import History
from app.line.history.status import store_notice
from app.people.audit.acts import Act
from app.people.audit.api import Events
from app.people.audit.log import EventLog
from bus.instants import unix_now
from bus.messages import Message
from bus.validation import OneLine

MAX_OF_PERSON = 50
MAX_SHARED = 200
MAX_OF_SITE = 10_000
MAX_NAME = 80
MAX_QUERY = 4000
_MEMBERS = frozenset({"s", "span", "from", "to", "preset", "scale", "marks", "compare"})
"""The parameters of a page's address that are saved; its cursors are not."""
_COLUMNS = "id, sender, owner, name, query, shared"


@dataclass(frozen=True, slots=True)
class TrendView:
    """A saved view. ``query``: the address of the page without its path; ``sender``: the account that owns
    it, and ``owner`` its name."""

    id: int
    sender: str
    owner: str
    name: str
    query: str
    shared: bool


class TrendViews:
    """The table of saved views. A view saved again under its name replaces the earlier one."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def seen_by(self, person: Person) -> list[TrendView]:
        """Return the views of a person, then those that others share, by name. Raise StoreError."""

        def read(connection: StoreConnection) -> list[TrendView]:
            query = f"SELECT {_COLUMNS} FROM trend_view WHERE sender = ? OR shared = 1"
            return [_view(row) for row in connection.execute(query, (person.sender,))]

        found = await self._database.read(read)
        return sorted(found, key=lambda view: (view.sender != person.sender, view.name.casefold()))

    async def save(self, person: Person, events: EventLog, name: str, query: str, *, shared: bool) -> str:
        """Save a view, and return its address. Raise Problem 403 if it may not be shared, 409 and 422."""
        if shared:
            SHARE.check(person)
        name, address = name.strip(), clean(query)
        if not 1 <= len(name) <= MAX_NAME:
            raise Problem(422, "invalid", Message.of("view_name_length", most=MAX_NAME))

        def write(connection: StoreConnection) -> None:
            _refuse_full(connection, person.sender, name, shared=shared)
            put = upsert("trend_view", ("sender", "name"), ("owner", "query", "shared", "saved_at"))
            values = (person.sender, name, person.name, address, int(shared), unix_now())
            connection.execute(put, values)

        if shared:
            await events.record(**SHARE.by(person, name=name), also=write)
        else:
            await self._database.write(write)
        return address

    async def delete(self, person: Person, events: EventLog, number: int) -> None:
        """Delete a view. Raise Problem 404, and 403 for the shared one of another person."""

        def find(connection: StoreConnection) -> TrendView | None:
            row = connection.execute(f"SELECT {_COLUMNS} FROM trend_view WHERE id = ?", (number,)).fetchone()
            return None if row is None else _view(row)

        def remove(connection: StoreConnection) -> None:
            connection.execute("DELETE FROM trend_view WHERE id = ?", (number,))

        view = await self._database.read(find)
        is_own = view is not None and view.sender == person.sender
        if view is None or not (is_own or view.shared):
            raise Problem(404, "not_found", Message("view_unknown"))
        if not is_own:
            DELETE_SHARED.check(person)
        if view.shared:
            await events.record(**DELETE_SHARED.by(person, name=view.name), also=remove)
        else:
            await self._database.write(remove)


def clean(query: str) -> str:
    """Return the members of an address of the page that are saved. Raise Problem 422 without any."""
    if len(query) <= MAX_QUERY:
        members = [(name, value) for name, value in parse_qsl(query) if name in _MEMBERS]
        address = urlencode(members)
        if members and len(address) <= MAX_QUERY:
            return address
    raise Problem(422, "invalid", Message("view_malformed"))


def _view(row: tuple[int, str, str, str, str, int]) -> TrendView:
    number, sender, owner, name, query, shared = row
    return TrendView(number, sender, owner, name, query, bool(shared))


def _refuse_full(connection: StoreConnection, sender: str, name: str, *, shared: bool) -> None:
    """Raise Problem 409 if there would be too many views."""

    def count(condition: str, *values: object) -> int:
        query = f"SELECT count(*) FROM trend_view WHERE NOT (sender = ? AND name = ?) AND {condition}"
        return int(connection.execute(query, (sender, name, *values)).fetchone()[0])

    if count("sender = ?", sender) >= MAX_OF_PERSON:
        raise Problem(409, "too_many", Message.of("views_of_person_full", n=MAX_OF_PERSON))
    if (shared and count("shared = 1") >= MAX_SHARED) or count("1 = 1") >= MAX_OF_SITE:
        raise Problem(409, "too_many", Message("views_of_site_full"))


SHARE = Act("share_view", Role.OPERATOR, "configuration", "event_view_shared")
DELETE_SHARED = Act("delete_shared_view", Role.ENGINEER, "configuration", "event_view_deleted")
"""The act of deleting another person's shared view; everyone may delete their own."""
ACTS = (SHARE, DELETE_SHARED)


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
SEE_OTHER = 303
SavedViews = Annotated[TrendViews, service(TrendViews)]


@router.get("/trends")
async def trends(request: Request, person: Viewer, history: HistoryOf, views: SavedViews) -> Response:
    """Show any values of any units over any span; the browser draws what the address names."""
    templates = templates_of(request)
    language = templates.language_of(request)
    return render(
        request,
        "trends/page.html",
        catalogue=_catalogue(history),
        words={name: values.text(value, language.t) for name, value in VALUES.items()},
        has_parquet=has_parquet(),
        memory=store_notice(history.status, templates.formats(language.tag), unix_now()),
        shift_starts=history.shift_starts,
        views=await _views_seen(views, person),
    )


async def _views_seen(views: TrendViews, person: Person) -> list[TrendView]:
    """Return the saved views of a person; none if the store cannot be read, which the chart does not need."""
    try:
        return await views.seen_by(person)
    except StoreError:
        return []


@router.post("/trends/views")
async def save_view(
    person: Viewer,
    views: SavedViews,
    events: Events,
    name: Annotated[OneLine, Form(max_length=200)] = "",
    query: Annotated[OneLine, Form(max_length=MAX_QUERY)] = "",
    shared: Annotated[bool, Form()] = False,
) -> Response:
    """Save the view of the page under a name; an operator may share it with everyone."""
    address = await views.save(person, events, name, query, shared=shared)
    return RedirectResponse(f"/trends?{address}#trend-save", SEE_OTHER)


@router.post("/trends/views/{number}/delete")
async def delete_view(
    person: Viewer, views: SavedViews, events: Events, number: Annotated[int, Path(ge=1, le=2**62)]
) -> Response:
    """Delete a saved view."""
    await views.delete(person, events, number)
    return RedirectResponse("/trends", SEE_OTHER)


def _catalogue(history: History) -> list[dict[str, Any]]:
    """Return every unit in floor order, with its wiring and its measure. With several buses, its name begins
    with that of its bus."""
    several = len(history.buses) > 1
    return [
        {
            "key": f"{bus.name}/{unit.id}",
            "name": f"{bus.name} · {unit.name}" if several else unit.name,
            "labels": {name: text for name, value in VALUES.items() if (text := values.label(unit, value))},
            "measures": {"speed": unit.labels.unit, "analog": unit.labels.analog_unit},
        }
        for bus in history.buses.values()
        for unit in bus.unit
    ]


def make(services: Services) -> None:
    services.add(TrendViews(services[Database]))
    settings = services.settings
    history = services.add(
        History(
            settings.server.data, settings.bus, settings.history, settings.site.zone, settings.shift.minutes
        )
    )

    async def start() -> None:
        history.start()

    services.lifespan.add("history", start=start, end=partial(asyncio.to_thread, history.close))


FEATURE = Feature(make, (api.router, router), ACTS)
