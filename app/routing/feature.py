"""Which server responds to a request."""

from __future__ import annotations

from functools import partial

from app.database import Database
from app.feature import Feature, Services
from app.home.homes import Homes
from app.routing.other_lines import OtherLines
from app.routing.peers import Peers
from app.routing.site_servers import SiteServers
from bus.instants import unix_now


def make(services: Services) -> None:
    homes, database, tls = services[Homes], services[Database], services.settings.server.tls
    servers = services.add(SiteServers(homes, tuple(services.buses)))
    peers = services.add(Peers(tls.client_ca if tls is not None else None))
    services.add(OtherLines(servers, peers))
    if homes.is_shared:
        read_clock = partial(database.read, lambda _: unix_now())
        compare = partial(servers.compare_clocks, read_clock)
        services.lifespan.add(
            "requests of other servers", compare, start=partial(servers.load, database), end=peers.close
        )


FEATURE = Feature(make)
