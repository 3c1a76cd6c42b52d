"""Commands to units, checked, recorded, sent, and read back; and ``GET /buses/{bus}/trace``: the frames that
a worker has kept, decoded, as JSON or as a file.

The frames show every value that passed, so the trace needs an engineer.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Iterable, Iterator
from datetime import UTC, datetime
from functools import partial
from typing import Annotated, Any, NamedTuple

from fastapi import APIRouter, Query
from starlette.responses import JSONResponse, Response, StreamingResponse
from typing_extensions import TypedDict

from app.core.database import Database
from app.core.find.finders import MAX_OF_KIND, Finders, FoundPlace, Search, missing, rank
from app.core.web.access import Person
from app.core.web.api import ApiRoute
from app.core.web.routes import DOWNLOAD
from app.core.web.shape import attachment
from app.core.web.templating import Templates
from app.errors import Problem
from app.feature import Feature, Services
from app.line.commands import api, safeguards_api
from app.line.commands.api import FrameShown, frame_json
from app.line.commands.catalogue import READ_TRACE, ROLES_BY_COMMAND
from app.line.commands.pages import bus, line, speed, unit
from app.line.commands.record import CommandRecord
from app.line.commands.safeguards import ACTS, Safeguards
from app.line.commands.service import END_SCAN, Commands, CommandService, permitted
from app.line.commands.trace_file import trace_line
from app.line.feed.bus_feed import HeldSpeeds
from app.line.feed.channel import Channel
from app.line.live.bus_live import BusLive, LiveState, UnitLive, staged_units
from app.line.live.fields import unit_key
from app.line.live.hub import Hub
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from bus.catalogue.parameters import PARAMETERS, Parameter
from bus.contract import Frame, ReadTrace
from bus.instants import HOUR_S, UnixTime, unix_now
from bus.messages import Message, parameter_name

router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["trace"], route_class=ApiRoute)
RECENT_S = 60.0
PIECE = 2000
MAX_PIECES = 200
"""An hour of a full bus has 140 pieces. This bounds a download from a worker that never ends."""


class TraceShown(TypedDict):
    """The last frames of a bus, oldest first."""

    bus: str
    frames: list[FrameShown]


TRACE: dict[int | str, dict[str, Any]] = {
    200: {"model": TraceShown, "content": {"text/plain": {"schema": {"type": "string"}}}}
}


@router.get("/trace", responses=TRACE, dependencies=[DOWNLOAD])
async def get_trace(
    person: Annotated[Person, permitted(READ_TRACE)],
    commands: Commands,
    bus: str,
    seconds: Annotated[float | None, Query(gt=0, le=HOUR_S)] = None,
    limit: Annotated[int, Query(ge=1, le=PIECE)] = 200,
) -> Response:
    """Return the last ``limit`` frames as JSON; with ``seconds`` all of that time as a text file, one frame a
    line, which ``lineside decode`` reads back."""
    now = unix_now()
    if seconds is None:
        frames: deque[Frame] = deque(maxlen=limit)
        async for piece in _pieces(commands, person, now - RECENT_S):
            frames.extend(piece)
        return JSONResponse({"bus": bus, "frames": [shown async for shown in _shown(frames)]})
    pieces = _pieces(commands, person, now - seconds)
    first: list[Frame] = await anext(pieces, [])
    name = f"{bus}-{datetime.fromtimestamp(float(now), UTC):%Y%m%dT%H%M%SZ}.trace.txt"
    return StreamingResponse(_lines(first, pieces), headers=attachment(name), media_type="text/plain")


async def _pieces(commands: CommandService, person: Person, since: UnixTime) -> AsyncIterator[list[Frame]]:
    for _ in range(MAX_PIECES):
        result = await commands.send(person, ReadTrace(since=since, limit=PIECE))
        if result.outcome not in ("verified", "acknowledged"):
            reason = result.message or Message("worker_no_result")
            raise Problem(503, result.outcome, reason, outcome=result.outcome)
        frames = [frame for frame in result.frames if frame.at > since]
        if frames:
            yield frames
        if len(result.frames) < PIECE:
            return
        since = frames[-1].at


async def _shown(frames: Iterable[Frame]) -> AsyncIterator[FrameShown]:
    """Yield each frame as JSON. Two thousand take a tenth of a second, during which others have their
    turns."""
    for frame in frames:
        yield frame_json(frame)
        await asyncio.sleep(0)


async def _lines(first: list[Frame], pieces: AsyncIterator[list[Frame]]) -> AsyncIterator[str]:
    yield _text(first)
    async for frames in pieces:
        yield _text(frames)


def _text(frames: list[Frame]) -> str:
    return "".join(f"{trace_line(frame)}\n" for frame in frames)


def make(services: Services) -> None:
    services[Templates].permit(ROLES_BY_COMMAND)
    services[Finders].add("find_parameters", ParameterFinder(services[LiveState]))
    database, events, rights, hub = services[Database], services[EventLog], services[Rights], services[Hub]
    record = CommandRecord(events, database, unix_now)
    for name, of_bus in services.buses.items():
        guards = Safeguards(
            name,
            of_bus[BusLive].units,
            database,
            events,
            control_required=services.settings.site.control,
            find=services[Accounts].find,
            rights=rights,
        )
        guards.on_block(partial(hub.refresh_unit, name))
        guards.on_control(hub.show_control)
        services[Sources].guards[name] = guards
        services.lifespan.add(f"safeguards of {name}", start=of_bus.add(guards).load)
        live, channel, held = of_bus[BusLive], of_bus[Channel], of_bus[HeldSpeeds]
        of_bus.add(CommandService(live, channel, record, guards, rights, held))
    all_guards = services.of_buses(Safeguards).values()
    lives = services.of_buses(BusLive)
    services[Templates].parts["staged"] = lambda *_: staged_units(lives.values(), unix_now())
    services[Templates].parts["controls"] = lambda *_: [guards.bus_control() for guards in all_guards]


class _Page(NamedTuple):
    """The page of a unit."""

    key: str
    unit: UnitLive


class ParameterFinder:
    """The finder of parameters by number, name or meaning, of the unit named with them or whose page is
    open."""

    def __init__(self, live: LiveState) -> None:
        self._live = live

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """Find the ramp of Coater for "coater ramp", and for "9" that of the page's unit, or the first."""
        pages = [
            _Page(unit_key(name, number), unit)
            for name, bus in self._live.buses.items()
            for number, unit in bus.units.items()
        ]
        near = [page for page in pages if search.near.startswith(f"/units/{page.key}")]
        return [
            place
            for parameter in PARAMETERS.values()
            for place in _places_of(search, parameter, pages, near or pages[:1])
        ]


def _places_of(
    search: Search, parameter: Parameter, pages: list[_Page], near: list[_Page]
) -> Iterator[FoundPlace]:
    texts = (search.language.t(text) for text in (parameter.name, parameter.meaning))
    names = [str(parameter.number), parameter.name, *texts]
    of_unit = missing(search.words, names)
    if len(of_unit) == len(search.words):
        return
    how_well = rank([word for word in search.words if word not in of_unit], names) or 0
    named = [page for page in pages if rank(of_unit, page.unit.names) is not None] if of_unit else near
    title = search.language.t(parameter_name(parameter.number))
    for page in named[:MAX_OF_KIND]:
        href = f"/units/{page.key}/parameters#parameter-{parameter.number}"
        yield FoundPlace(title, href, page.unit.settings.name, how_well + 1)


FEATURE = Feature(
    make,
    (
        api.router,
        safeguards_api.router,
        router,
        line.router,
        speed.router,
        line.staged_router,
        unit.parameters_router,
        bus.router,
        unit.router,
    ),
    (*ACTS, END_SCAN),
)
