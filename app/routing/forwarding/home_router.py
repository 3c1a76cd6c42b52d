"""Passes a request of another server's bus on to the home of that bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as AsgiMessage
from starlette.websockets import WebSocket

from app.errors import Problem
from app.home.homes import Home
from app.routing.forwarding.courier import Courier, home_away
from app.routing.forwarding.headers import to_home
from app.routing.forwarding.hop import HEADER
from app.routing.forwarding.socket_relay import SocketRelay
from app.routing.forwarding.target import (
    ALARMS,
    COOKIE,
    SERVER_IN_HEADER,
    Destination,
    is_own,
    named_bus,
    named_server,
    place_of,
    prefixes_of,
)
from app.routing.peers import Peers
from app.routing.site_servers import SiteServers, target_of
from app.server.admission.addresses import source_of
from app.web.admission.access import Role, address_of, person_of
from app.web.admission.arrival import SAFE_METHODS
from app.web.admission.security import PASSED_ON, REFUSED_AT_HOME
from app.web.problems import refuse_socket, respond, too_many_requests
from bus.messages import Message

MAX_OF_ACCOUNT, MAX_OF_ADDRESS, MAX_IN_ALL = 64, 128, 300
"""Requests that are passed on at a time."""
MAX_SOCKETS_OF_ACCOUNT, MAX_SOCKETS_OF_ADDRESS, MAX_SOCKETS = 256, 512, 600
"""The first two as for the pages of one server."""
YEAR_S = 365 * 24 * 3600


class HomeRouter:
    """Middleware, inside of what authenticates. It grants nothing: the home authenticates the same cookie or
    token again and checks every role itself."""

    def __init__(self, app: ASGIApp, servers: SiteServers, peers: Peers) -> None:
        self._app = app
        self._servers = servers
        self._courier = Courier(peers)
        self._relay = SocketRelay(peers)
        self._requests = _Bounds(MAX_OF_ACCOUNT, MAX_OF_ADDRESS, MAX_IN_ALL)
        self._sockets = _Bounds(MAX_SOCKETS_OF_ACCOUNT, MAX_SOCKETS_OF_ADDRESS, MAX_SOCKETS)
        self._prefixes: tuple[str, ...] | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        is_request = scope["type"] in ("http", "websocket")
        if not is_request or not self._servers.is_shared or is_own(scope["path"]):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        person = person_of(connection)
        if person is None or person.role is Role.WORKER:
            await self._app(scope, receive, send)
            return
        bus = named_bus(scope["path"], scope["query_string"], self._prefixes_in(scope))
        place = self._place(connection, bus, via_session=person.via == "session")
        if place.home is None:
            await self._app(scope, receive, _remembering(place, connection, send))
            return
        await self._pass_on(place, connection, person.account, receive, send)

    def _place(self, connection: HTTPConnection, bus: str, *, via_session: bool) -> Destination:
        """A program keeps no cookie: what names no bus is responded to by the server that it chose. So is
        what another server has passed on."""
        scope, servers = connection.scope, self._servers
        server = named_server(
            scope["query_string"],
            connection.cookies.get(COOKIE, "") if via_session else "",
            connection.headers.get(SERVER_IN_HEADER, "") if via_session else "",
            is_socket=scope["type"] == "websocket",
        )
        is_merged = scope["path"] == ALARMS
        if not bus and (PASSED_ON in scope or is_merged or not (via_session or server)):
            return Destination()
        return place_of(bus, server, servers.homes, servers.buses)

    async def _pass_on(
        self, place: Destination, connection: HTTPConnection, account: str, receive: Receive, send: Send
    ) -> None:
        scope, home = connection.scope, place.home
        assert home is not None
        is_socket = scope["type"] == "websocket"
        bounds = self._sockets if is_socket else self._requests
        address = source_of(address_of(connection))
        try:
            self._refuse_hop(scope, home)
            with bounds.taken(account, address):
                target = target_of(scope)
                headers = to_home(scope["headers"])
                headers.append((HEADER.encode(), self._servers.seal(scope, target).encode()))
                scope[REFUSED_AT_HOME] = True
                carry = self._relay.carry if is_socket else self._courier.carry
                await carry(home, target, headers, scope, receive, _remembering(place, connection, send))
        except Problem as problem:
            if is_socket:
                await refuse_socket(WebSocket(scope, receive, send), problem)
            else:
                await respond(Request(scope), problem)(scope, receive, send)

    def _refuse_hop(self, scope: Scope, home: Home) -> None:
        """Raises Problem 503 for a request that was passed on already, and where its age could not be
        stated."""
        is_write = scope["type"] == "http" and scope["method"] not in SAFE_METHODS
        if PASSED_ON in scope:
            # Two servers that each believe the other to be the home would pass it on without end.
            message = Message.of("home_changes", bus=home.bus, server=home.server)
            code, extra = ("bus_closed", {"outcome": "not_sent"}) if is_write else ("home_away", {})
            raise Problem(503, code, message, **extra)  # type: ignore[arg-type]
        if not self._servers.is_clock_known:
            raise home_away(home, is_write=is_write)

    def _prefixes_in(self, scope: Scope) -> tuple[str, ...]:
        if self._prefixes is None:
            self._prefixes = prefixes_of(getattr(route, "path", "") for route in scope["app"].routes)
        return self._prefixes


def _remembering(place: Destination, connection: HTTPConnection, send: Send) -> Send:
    """The browser looks at the home whose page it gets."""
    if (
        not place.looked_at
        or connection.scope["type"] != "http"
        or connection.scope["method"] != "GET"
        or connection.cookies.get(COOKIE) == place.looked_at
    ):
        return send

    async def remembering(message: AsgiMessage) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            if headers.get("content-type", "").startswith("text/html"):
                headers.append("set-cookie", home_cookie(place.looked_at, connection))
        await send(message)

    return remembering


def home_cookie(server: str, connection: HTTPConnection) -> str:
    """The value of Set-Cookie by which a browser looks at a server from now on."""
    secure = "; Secure" if connection.scope["scheme"] in ("https", "wss") else ""
    return f"{COOKIE}={server}; Max-Age={YEAR_S}; Path=/; HttpOnly; SameSite=lax{secure}"


class _Bounds:
    """How many requests are passed on at a time, for an account, an address and in all."""

    def __init__(self, of_account: int, of_address: int, in_all: int) -> None:
        self._most = {"account": of_account, "address": of_address, "all": in_all}
        self._open: Counter[tuple[str, str]] = Counter()

    @contextmanager
    def taken(self, account: str, address: str) -> Iterator[None]:
        """One more while it lasts. Raises Problem 429."""
        keys = (("account", account), ("address", address), ("all", ""))
        if any(self._open[key] >= self._most[key[0]] for key in keys):
            raise too_many_requests()
        self._open.update(keys)
        try:
            yield
        finally:
            self._open.subtract(keys)
            self._open += Counter()
