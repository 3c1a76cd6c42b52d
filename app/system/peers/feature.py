"""The feature of lines of this server and its peers: ``GET /sites``, the page of all lines, and the
wallboard, which shows one line at a time across a hall."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from app.core.messages import DEFAULT
from app.core.web.access import Viewer
from app.core.web.api import ApiRoute
from app.core.web.routes import GuardedRoute
from app.core.web.services import service, service_of, unknown_bus
from app.core.web.templating import PageLines, Templates, render, templates_of
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.live.bus_live import LiveState
from app.line.live.fields import Translator, unit_key
from app.line.live.hub import Hub
from app.line.live.pages import UnitOnLine, unit_on_line
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from app.system.peers.board import LineBoard, LineOnBoard, LineTiles, LineTilesService, Peer
from app.system.peers.client import LinesOfSites, board_json, follow
from app.system.peers.summary import LastEvents, OwnLines
from bus.instants import unix_now

api = APIRouter(prefix="/api/v1", tags=["line"], route_class=ApiRoute)
router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
TemplatesService = Annotated[Templates, service(Templates)]
LastEventsService = Annotated[LastEvents, service(LastEvents)]
Own = Annotated[bool, Query(description="Only the lines of this server, without those of its peers.")]
Size = Literal["large", "medium", "small", "tiny"]
MAX_OF: dict[Size, int] = {"large": 12, "medium": 24, "small": 54, "tiny": 255}
"""The most sections of a line for which each is shown with its speed, with only its name, as one of up to
three rows, and as one of more rows."""


@api.get("/sites")
async def get_sites(
    _: Viewer,
    tiles: LineTilesService,
    events: LastEventsService,
    templates: TemplatesService,
    own: Own = False,
    site: str | None = None,
) -> LinesOfSites:
    """List every line of this server and its peers, the worst first. ``site``: only lines of the site with
    this name."""
    await events.read()
    english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
    report = board_json(tiles.board, english, unix_now(), own=own)
    if site is not None:
        report["lines"] = [line for line in report["lines"] if line["site"] == site]
    return report


@router.get("/lines")
async def lines_page(
    request: Request, _: Viewer, tiles: LineTilesService, events: LastEventsService, site: str = ""
) -> Response:
    """Show every line, the worst first; ``site``: only lines of that site, if there is such a site."""
    await events.read()
    lines = tiles.board.lines()
    sites = sorted({line.site for line in lines})
    chosen = site if site in sites else ""
    hub = service_of(request, Hub)
    units = {line.key: [*hub.live.buses[line.bus].units] for line in lines if line.peer is None}
    return render(
        request,
        "lines/page.html",
        lines=[line for line in lines if chosen in ("", line.site)],
        tiles=tiles.fields_of(lines, _translator(request)),
        firsts={line.key: unit_key(line.bus, units[line.key][0]) for line in lines if units.get(line.key)},
        units=hub.screen(templates_of(request).language_of(request).tag).flat(),
        sites=sites,
        chosen=chosen,
    )


@dataclass(frozen=True, slots=True)
class LineOnWall:
    """The parts of a line that do not change while the page is open. ``peer``: its reporter, empty for this
    server; ``units``: the sections of an own line in floor order."""

    bus: str
    peer: str
    key: str
    units: list[UnitOnLine]
    measure: str

    @property
    def name(self) -> str:
        return " · ".join(filter(None, (self.peer, self.bus)))

    @property
    def href(self) -> str:
        """The address of the wallboard of this line alone."""
        query = {"bus": self.bus} | ({"peer": self.peer} if self.peer else {})
        return f"/wallboard?{urlencode(query)}"

    @property
    def size(self) -> Size:
        """The size in which each section of the line has room."""
        return next(size for size, most in MAX_OF.items() if len(self.units) <= most)


@router.get("/wallboard")
async def wallboard_page(
    request: Request,
    _: Viewer,
    tiles: LineTilesService,
    events: LastEventsService,
    bus: str = "",
    peer: str = "",
) -> Response:
    """Show every line in turn, or only that of ``bus`` (and ``peer``, if given). Raise Problem 404."""
    await events.read()
    hub = service_of(request, Hub)
    reported = tiles.board.lines()
    order = [*hub.live.buses]
    lines = [_on_wall(hub, line) for line in reported]
    lines.sort(key=lambda line: (line.peer, line.bus not in order or order.index(line.bus), line.bus))
    shown = [line for line in lines if (bus, peer) in (("", ""), (line.bus, line.peer))]
    if not shown and (bus or peer):
        raise unknown_bus(bus, [line.bus for line in lines if line.peer == peer])
    language = templates_of(request).language_of(request)
    return render(
        request,
        "wallboard/page.html",
        lines=shown,
        every=lines,
        chosen=shown[0].key if bus or peer else "",
        tiles=tiles.fields_of(reported, _translator(request)),
        fields=hub.screen(language.tag).flat(),
    )


def _on_wall(hub: Hub, line: LineOnBoard) -> LineOnWall:
    measure = "" if line.summary is None else line.summary.measure
    if line.peer is not None:
        return LineOnWall(line.bus, line.peer.name, line.key, [], measure)
    units = [unit_on_line(line.bus, unit) for unit in hub.live.buses[line.bus].units.values()]
    return LineOnWall(line.bus, "", line.key, units, measure)


def _translator(request: Request) -> Translator:
    templates = templates_of(request)
    language = templates.language_of(request).on_screen
    return Translator(language, templates.formats(language.tag))


def make(services: Services) -> None:
    templates, settings = services[Templates], services.settings
    events = services.add(LastEvents(services[LiveState], services[EventLog]))
    own = OwnLines(
        settings.site.name,
        services[LiveState],
        services[LineAlarms],
        services[Sources],
        events,
        Translator(templates.languages[DEFAULT], templates.formats(DEFAULT)),
    )
    peers = [Peer(number, peer.name, peer.url) for number, peer in enumerate(settings.peer, 1)]
    board = LineBoard(own.summaries, peers)
    has_overview = settings.mqtt is not None and settings.mqtt.overview
    services[Hub].show_lines(services.add(LineTiles(board, unix_now)))
    services.add(
        PageLines(
            has_several=len(services.buses) > 1 or bool(peers) or has_overview, has_own=bool(services.buses)
        )
    )
    services.lifespan.add("speeds of lines", own.trace)
    services.lifespan.add("last events of lines", events.follow)
    services.lifespan.add(
        "peers",
        *(partial(follow, peer, each, board) for peer, each in zip(peers, settings.peer, strict=True)),
    )


FEATURE = Feature(make, (api, router))
