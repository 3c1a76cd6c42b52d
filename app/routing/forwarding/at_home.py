"""What names its bus in the body, or by a number in the store, is repeated at the home of that bus."""

from __future__ import annotations

from urllib.parse import quote

from starlette.requests import HTTPConnection

from app.errors import Problem
from app.routing.forwarding.target import names_bus
from app.routing.site_servers import SiteServers, target_of
from app.web.services import service_of
from bus.messages import Message


def at_home_of(connection: HTTPConnection, bus: str) -> None:
    """Raises Problem 307 where another server is the home of ``bus``: the same request with ``?bus=`` is
    passed on to it. Nothing was done yet."""
    servers = service_of(connection, SiteServers)
    if not servers.is_elsewhere(bus):
        return
    server = servers.homes.of(bus).server
    if names_bus(connection.scope["query_string"]):
        # It was passed on already: two servers that each believe the other to be the home.
        raise Problem(503, "home_away", Message.of("home_changes", bus=bus, server=server))
    target = target_of(connection.scope).decode("latin-1")
    location = f"{target}{'&' if '?' in target else '?'}bus={quote(bus)}"
    problem = Problem(307, "bus_elsewhere", Message.of("home_elsewhere", bus=bus, server=server))
    raise problem.with_headers(Location=location)
