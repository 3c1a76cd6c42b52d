"""The server: uvicorn with a gate in front of each connection, and the lifetime of a site's services.

Imported by :mod:`app.cli.hosting` while the workers start: it imports FastAPI and every feature.
"""

from __future__ import annotations

import asyncio
import resource
import socket
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from typing import Any, cast

import uvicorn.server
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.cli.starting import BACKLOG
from app.core.server.connections import Connections
from app.core.server.gate import RECEIVE_BUFFER_BYTES, Gate, Gates, LoopWatch, Stages
from app.core.server.refusal_log import ErrorLines, RefusalLog
from app.core.server.refusals import TLS_REQUIRED
from app.core.server.tls import Encryption
from app.feature import Services
from app.line.feed.socket import Workers
from app.line.live.api.routes import LineStream
from app.main import create_app
from app.people.auth.sign_in import FirstAdmin
from app.settings import Settings
from app.system.configuration.service import Restart
from bus.instants import Monotonic

GRACEFUL_S = 1
"""The time that requests in flight get when the server ends."""
ENOUGH_FILES, FILES_OF_OTHERS = 4096, 256
"""The files that this process may have open, more than all connections and stores together need; and the
files that are not connections."""
FEED = "/feed"
NOT_HERE = 1008
"""The close code for a WebSocket that may not be opened (RFC 6455, 7.4.1)."""
TICK_S = 1.0
MAX_MESSAGE_BYTES = 4 * 1024 * 1024


class Server(uvicorn.server.Server):
    """uvicorn's server, which leaves signals to its host and reports when it serves."""

    def __init__(
        self,
        settings: Settings,
        demo: bool,
        worker_tokens: Mapping[str, str],
        serving: Callable[[str], None],
        since: Monotonic,
        feed: socket.socket | None = None,
    ) -> None:
        """Prepare the server. ``serving``: called with the code for the first admin (empty if a user exists);
        ``since``: when the first client can have connected; ``feed``: the workers' port, beside HTTPS."""
        self._watch = LoopWatch(since)
        connections = Connections(settings.server.trusted_proxies, _raise_file_limit())
        app: ASGIApp = create_app(settings, demo=demo, worker_tokens=worker_tokens)
        self.services: Services = app.state.services  # type: ignore[attr-defined]
        self.worker_responds: Callable[[str], bool] = self.services[Workers].responds
        refusals, errors = self.services[RefusalLog], ErrorLines()
        self._gates = Gates(connections, refusals, self._watch)
        certificate = self.services[Encryption].certificate
        if certificate is not None:
            self._gates.choose_context = certificate.context_for
        self._feed = () if feed is None else (feed,)
        if feed is not None:
            self._gates.in_clear = feed.getsockname()[:2]
            app = OnlyFeed(app, feed.getsockname()[:2])
        super().__init__(_config(Stages(app), self._gates))
        errors.install()
        self._each_second: list[Callable[[], None]] = [self._gates.check, refusals.sum_up, errors.sum_up]
        self._serving = serving

    def each_second(self, act: Callable[[], None]) -> None:
        """Call ``act`` once a second while the server runs."""
        self._each_second.append(act)

    def offer_restart(self) -> asyncio.Event:
        """Let people restart the server; the returned event is set a moment after one has."""
        return self.services[Restart].offer()

    def end(self) -> None:
        """Close all connections, then end serving."""
        self.should_exit = True
        self.services[LineStream].end()
        self._gates.end()

    def capture_signals(self) -> Any:
        """Leave signals to the host: the workers must end before the server."""
        return nullcontext()

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until :meth:`end`. Raise StartError if a service cannot start."""
        listening = [*(sockets or ()), *self._feed]
        for each in listening:
            each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)  # inherited
        async with self.services.lifespan.running():
            ticking = asyncio.create_task(self._tick())
            try:
                await super().serve(listening)
            finally:
                self._watch.stop()
                ticking.cancel()
                await asyncio.gather(ticking, return_exceptions=True)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start as uvicorn does, and report that the dashboard serves."""
        await super().startup(sockets)
        self._watch.start()
        self._serving(self.services[FirstAdmin].code)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            for act in self._each_second:
                act()


def _config(app: ASGIApp, gates: Gates) -> Config:
    """Return uvicorn's settings. WebSockets are not compressed: at ten messages a second that costs a quarter
    of a core."""
    return Config(
        app,
        loop="none",
        http=cast(type[asyncio.Protocol], partial(Gate, gates, HttpToolsProtocol)),
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        ws_max_size=MAX_MESSAGE_BYTES,
        # Pages and workers send by themselves, and are given up if they do not (app.line.live.hub,
        # app.line.feed.bus_feed). On a busy machine, late pings ended connections that worked.
        ws_ping_interval=None,
        access_log=False,
        proxy_headers=False,  # app.core.server.addresses does it, for the proxies that are named
        log_config=None,
        log_level="error",
        server_header=False,
        lifespan="off",  # `serve` runs the services: an error of their start is one line there
        timeout_graceful_shutdown=GRACEFUL_S,
        backlog=BACKLOG,
    )


class OnlyFeed:
    """The app, limited to the feed at ``address``, where the server's own workers connect unencrypted: people
    sign in by HTTPS."""

    def __init__(self, app: ASGIApp, address: tuple[str, int]) -> None:
        self._app = app
        self._address = address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        is_here = scope.get("server") == self._address
        if not is_here or (scope["type"] == "websocket" and scope["path"] == FEED):
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": NOT_HERE})
        else:
            await TLS_REQUIRED(scope, receive, send)


def _raise_file_limit() -> int:
    """Raise the limit of open files as far as the system allows and is useful; return the number that may be
    sockets."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = ENOUGH_FILES if hard == resource.RLIM_INFINITY else min(ENOUGH_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
        soft = allowed
    return max(FILES_OF_OTHERS, (ENOUGH_FILES if soft == resource.RLIM_INFINITY else soft) - FILES_OF_OTHERS)
