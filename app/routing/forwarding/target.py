"""Where a request belongs: the bus that it names, else the home that its browser looks at. Pure."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from urllib.parse import parse_qsl

from app.home.homes import Home
from app.home.lease import SITE
from app.routing.homes import BusHomes

COOKIE = "lineside_home"
"""Names the server that a browser looks at."""
SERVER_IN_HEADER = "lineside-home"
"""Names the server that has made a page, in its requests: another tab may look at another home."""
SERVER_IN_QUERY, HERE = "home", "here"
"""The same for the socket of a page. ``here``: the server at hand."""
OWN_PATHS = frozenset(
    {
        *(
            "/healthz",
            "/login",
            "/login/panel",
            "/logout",
            "/setup",
            "/feed",
            "/lines",
            "/wallboard",
            "/offline",
            "/sw.js",
        ),
        *("/manifest.webmanifest", "/favicon.ico", "/api/v1/sites", "/api/v1/line", "/api/v1/openapi.json"),
        "/api/v1/asyncapi.json",
        *("/metrics", "/api/v1/me"),
    }
)
"""What every server responds to itself."""
OWN_PREFIXES = ("/static/", "/login/", "/feed/", "/lines/")
ALARMS = "/api/v1/alarms"
"""Responded to by the server at hand, which requests those of the others, unless a bus is named."""
SITE_IN_ID = "_"
"""In the place of a bus in the id of an alarm of the site, and of a link to its home."""
_ALARM = re.compile(r"/(?:api/v1/)?alarms/(?:own/)?(_|[a-z0-9-]{1,40})\.[^/]*(?:/.*)?")
"""The id of an alarm begins with its bus (`app.alarms.alarm`); a slug has no full stop."""
_BUS = re.compile(r"_|[a-z0-9][a-z0-9-]{0,39}")
_SLUG = re.compile(r"[a-z0-9][a-z0-9-]{0,39}")


def prefixes_of(paths: Iterable[str]) -> tuple[str, ...]:
    """What stands before ``{bus}`` in the paths of the routes that have it."""
    return tuple(sorted({path.partition("{bus}")[0] for path in paths if "{bus}" in path}))


def is_own(path: str) -> bool:
    """Whether every server responds to this path itself."""
    return path in OWN_PATHS or path.startswith(OWN_PREFIXES)


def named_bus(path: str, query: bytes, prefixes: Collection[str]) -> str:
    """The bus that a request names, which there may not be; empty for none. A query that names two is
    left to the route, which refuses it."""
    for prefix in prefixes:
        if path.startswith(prefix):
            segment = path[len(prefix) :].partition("/")[0]
            if _SLUG.fullmatch(segment):
                return segment
    if found := _ALARM.fullmatch(path):
        return found[1]
    named = _values(query, "bus")
    return named[0] if len(named) == 1 and _BUS.fullmatch(named[0]) else ""


def names_bus(query: bytes) -> bool:
    """Whether a query names a bus."""
    return bool(_values(query, "bus"))


def named_server(query: bytes, cookie: str, header: str = "", *, is_socket: bool) -> str:
    """The server that a request names which names no bus; empty for none."""
    named = _values(query, SERVER_IN_QUERY) if is_socket else []
    return named[0] if named else header or cookie


def _values(query: bytes, name: str) -> list[str]:
    if name.encode() not in query:
        return []
    pairs = parse_qsl(query.decode("latin-1"), keep_blank_values=True)
    return [value for key, value in pairs if key == name]


@dataclass(frozen=True, slots=True)
class Destination:
    """Where a request is responded to. ``home``: another server, None: this one. ``looked_at``: the id of the
    server that its browser looks at from now on; empty: as before."""

    home: Home | None = None
    looked_at: str = ""


def place_of(bus: str, server: str, homes: BusHomes, buses: Collection[str]) -> Destination:
    """Where a request belongs that names ``bus`` or, where that is empty, ``server``. ``buses``: of the
    configuration. A bus without a home is shown here, where it has no worker; a server that is no home is
    passed over, so that a browser follows a bus to its next home."""
    if bus:
        place = SITE if bus == SITE_IN_ID else bus
        holder = holder_of(place, homes)
        return Destination(None if holder in ("", homes.server) else homes.of(place), holder)
    if server == HERE:
        return Destination()
    by_server: dict[str, Home] = {}
    for each in buses:
        if holder := holder_of(each, homes):
            by_server.setdefault(holder, homes.of(each))
    if server in by_server:
        wanted = server
    else:
        wanted = homes.server if homes.server in by_server else next(iter(by_server), homes.server)
    return Destination(None if wanted == homes.server else by_server[wanted])


def holder_of(place: str, homes: BusHomes) -> str:
    """The id of the server that is the home now; empty where none is known. The row of a bus that was just
    taken is as it was a second ago."""
    return homes.server if homes.is_here(place) else homes.of(place).server
