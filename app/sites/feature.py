"""All lines of all servers."""

from __future__ import annotations

from functools import partial

from app.alarms.monitor.line_alarms import LineAlarms
from app.audit.log import EventLog
from app.commands.safeguards.service import Safeguards
from app.database import Database
from app.feature import Feature, Services
from app.home.homes import Homes
from app.live.screen.fields import Fields, Translator
from app.live.state.bus_live import LiveState
from app.messages import DEFAULT, Language
from app.recipes.book import RecipeBook
from app.routing.site_servers import SiteServers
from app.sets.comparison.drift import BusDrift
from app.sites import api, pages, wallboard
from app.sites.board import LineBoard
from app.sites.fleet import Fleet
from app.sites.last_events import LastEvents
from app.sites.own_lines import OwnLines
from app.sites.publisher import CHANNEL, SummaryPublisher, notify_lines
from app.web.rendering.templating import PageFleet, Templates
from bus.instants import unix_now


def make(services: Services) -> None:
    templates, homes = services[Templates], services[Homes]
    events = services.add(LastEvents(services[LiveState], services[EventLog], homes.is_here))
    own = OwnLines(
        services.settings.site.name,
        services[LiveState],
        services[LineAlarms],
        services.of_buses(Safeguards),
        services.of_buses(BusDrift),
        homes,
        services[RecipeBook],
        events,
        Translator(templates.languages[DEFAULT], templates.formats(DEFAULT)),
    )
    board = LineBoard(services.buses, own.summaries)
    servers = services[SiteServers]
    fleet = services.add(Fleet(board, unix_now, lambda: (home.bus for home in servers.elsewhere())))

    def alarms_in(language: Language) -> Fields:
        return fleet.alarms_elsewhere(Translator(language, templates.formats(language.tag)))

    server = homes.server if homes.is_shared else ""
    has_lines = partial(_has_lines, homes, board)
    services.add(PageFleet(has_lines, server, servers.elsewhere, alarms_in))
    services.lifespan.add("speeds of lines", own.trace)
    services.lifespan.add("last events of lines", events.follow)
    if homes.is_shared:
        _share(services, own, board)


def _has_lines(homes: Homes, board: LineBoard) -> bool:
    return homes.is_shared or board.is_fleet()


def _share(services: Services, own: OwnLines, board: LineBoard) -> None:
    """Exchange the summaries with the other servers."""
    database = services[Database]
    publisher = SummaryPublisher(own, partial(notify_lines, database))

    async def listen() -> None:
        database.listen(CHANNEL, lambda text: board.take(text) if text else None)

    services.lifespan.add("lines of the site", publisher.publish, start=listen, end=publisher.end)


FEATURE = Feature(make, (api.router, pages.router, wallboard.router))
