"""The lines of this server in short, for the page of all lines and the wallboard."""

from __future__ import annotations

from app.alarms.monitor.line_alarms import LineAlarms
from app.audit.log import EventLog
from app.commands.safeguards.service import Safeguards
from app.feature import Feature, Services
from app.live.screen.fields import Translator
from app.live.state.bus_live import LiveState
from app.messages import DEFAULT
from app.recipes.book import RecipeBook
from app.sets.comparison.drift import BusDrift
from app.sites import api, pages, wallboard
from app.sites.board import LineBoard
from app.sites.fleet import Fleet
from app.sites.last_events import LastEvents
from app.sites.own_lines import OwnLines
from app.web.rendering.templating import PageFleet, Templates
from bus.instants import unix_now


def make(services: Services) -> None:
    templates = services[Templates]
    events = services.add(LastEvents(services[LiveState], services[EventLog]))
    own = OwnLines(
        services.settings.site.name,
        services[LiveState],
        services[LineAlarms],
        services.of_buses(Safeguards),
        services.of_buses(BusDrift),
        services[RecipeBook],
        events,
        Translator(templates.languages[DEFAULT], templates.formats(DEFAULT)),
    )
    board = LineBoard(own.summaries)
    services.add(Fleet(board, unix_now))
    services.add(PageFleet(has_lines=len(services.buses) > 1))
    services.lifespan.add("speeds of lines", own.trace)
    services.lifespan.add("last events of lines", events.follow)


FEATURE = Feature(make, (api.router, pages.router, wallboard.router))
