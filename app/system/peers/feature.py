"""Makes the board of the lines of this server and its peers, and reads the peers."""

from __future__ import annotations

from functools import partial

from app.core.messages import DEFAULT
from app.core.web.templating import PageLines, Templates
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.live.bus_live import LiveState
from app.line.live.fields import Translator
from app.line.live.hub import Hub
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from app.system.peers import pages
from app.system.peers.board import LineBoard, LineTiles, Peer
from app.system.peers.client import follow
from app.system.peers.summary import LastEvents, OwnLines
from bus.instants import unix_now


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
    peers = tuple(Peer(number, peer) for number, peer in enumerate(settings.peer, 1))
    board = LineBoard(own.summaries, peers)
    services[Hub].show_lines(services.add(LineTiles(board, unix_now)))
    services.add(PageLines(has_several=len(services.buses) > 1 or bool(peers), has_own=bool(services.buses)))
    services.lifespan.add("speeds of lines", own.trace)
    services.lifespan.add("last events of lines", events.follow)
    services.lifespan.add("peers", *(partial(follow, peer, board) for peer in peers))


FEATURE = Feature(make, (pages.api, pages.router))
