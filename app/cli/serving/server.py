"""Uvicorn as the dashboard wants it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, cast

import uvicorn.server
from starlette.types import ASGIApp
from uvicorn.config import Config

from app.auth.sign_in.first_admin import FirstAdmin
from app.cli.serving.liveness import Liveness as Liveness
from app.configuration.restart import Restart as Restart
from app.database import Database as Database
from app.feature import Services
from app.feed.workers import Workers
from app.live.api.line_stream import LineStream
from app.main import create_app
from app.server.admission.refusal_log import ErrorLines, RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.accepting import accept_connections
from app.server.connection.connections import Connections
from app.server.connection.own_feed import OnlyFeed
from app.server.connection.stamping import StampingProtocol
from app.server.connection.websocket import WebSocketProtocol
from app.server.encryption import Encryption
from app.server.files import raise_file_limit
from app.server.loop_watch import LoopWatch
from app.settings import Settings

GRACEFUL_S = 1
"""What requests in flight get when the server ends."""
TICK_S = 1.0
MAX_MESSAGE_BYTES = 4 * 1024 * 1024


class Server(uvicorn.server.Server):
    """Leaves the signals to the host, and reports when it serves."""

    def __init__(
        self,
        settings: Settings,
        demo: bool,
        worker_tokens: Mapping[str, str],
        serving: Callable[[str], None],
        feed: socket.socket | None = None,
    ) -> None:
        """``feed``: where its own workers connect in clear, beside HTTPS; ``serving``: called with the code
        for the first admin, empty where there is a user."""
        self._watch = LoopWatch()
        connections = Connections(settings.server.trusted_proxies, raise_file_limit())
        app = create_app(settings, demo=demo, worker_tokens=worker_tokens)
        self.services: Services = app.state.services
        self.worker_responds: Callable[[str], bool] = self.services[Workers].responds
        refusals, errors = self.services[RefusalLog], ErrorLines()
        turns = LoopTurns()
        self._configure = partial(
            _config, watch=self._watch, open_connections=connections, turns=turns, refusals=refusals
        )
        super().__init__(self._configure(app))
        certificate = self.services[Encryption].certificate
        if certificate is not None:
            from app.server.tls.connection import TlsConnection

            self._make_public: Callable[[], asyncio.Protocol] = lambda: TlsConnection(
                self._make_protocol(self.config), certificate.context_for, turns, refusals
            )
        else:
            self._make_public = partial(self._make_protocol, self.config)
        self._feed = feed
        errors.install()
        self._sum_up = (refusals.sum_up, errors.sum_up)
        self._serving = serving
        self._each_second: Callable[[], None] = lambda: None
        self._ended = asyncio.Event()
        self._accepting: list[asyncio.Task[None]] = []

    def each_second(self, act: Callable[[], None]) -> None:
        """Call ``act`` once a second while it serves."""
        self._each_second = act

    def end(self) -> None:
        """Close all connections, then return from serving."""
        self.should_exit = True
        self.services[LineStream].end()
        self._ended.set()

    def capture_signals(self) -> Any:
        """The workers must end before the server does."""
        return nullcontext()

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until :meth:`end`. Raises StartError where a service cannot start."""
        async with self.services.lifespan.running():
            await super().serve(sockets)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start as uvicorn does, then accept connections and report that the dashboard serves."""
        self._watch.start()
        await super().startup([])
        if self.started:
            for listening in sockets or []:
                self._accept(listening, self._make_public)
            if self._feed is not None:
                config = self._configure(OnlyFeed(cast(ASGIApp, self.config.app)))
                self._accept(self._feed, partial(self._make_protocol, config))
            self._serving(self.services[FirstAdmin].code)

    def _accept(self, listening: socket.socket, make: Callable[[], asyncio.Protocol]) -> None:
        self._accepting.append(asyncio.create_task(accept_connections(listening, make)))

    async def main_loop(self) -> None:
        """Set the header ``Date`` once a second, and close connections of clients that take too long."""
        while not await self.on_tick(0):
            now = asyncio.get_running_loop().time()
            for connection in tuple(self.server_state.connections):
                connection.check(now)  # type: ignore[union-attr]
            for sum_up in self._sum_up:
                sum_up()
            self._each_second()
            with suppress(TimeoutError):
                async with asyncio.timeout(TICK_S):
                    await self._ended.wait()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop watching the loop and accepting connections, then shut down as uvicorn does."""
        self._watch.stop()
        for task in self._accepting:
            task.cancel()
        await asyncio.gather(*self._accepting, return_exceptions=True)
        await super().shutdown(sockets)

    def _make_protocol(self, config: Config) -> StampingProtocol:
        """Make the protocol of a connection, as uvicorn does for a server of asyncio's."""
        if not config.loaded:
            config.load()
        make = cast(Callable[..., StampingProtocol], config.http_protocol_class)
        return make(config=config, server_state=self.server_state, app_state=self.lifespan.state)


def _config(app: Any, **shared: Any) -> Config:
    """No deflate on WebSockets: at ten messages a second it costs a quarter of a core, and every page would
    need separate frames. ``shared``: what the protocol of every connection gets."""
    protocol = partial(StampingProtocol, **shared)
    return Config(
        app,
        loop="none",
        http=cast(type[asyncio.Protocol], protocol),
        ws=WebSocketProtocol,
        ws_per_message_deflate=False,
        ws_max_size=MAX_MESSAGE_BYTES,
        access_log=False,
        proxy_headers=False,  # app.server.admission.forwarded does it, for the proxies that are named
        log_config=None,
        log_level="error",
        server_header=False,
        lifespan="off",  # `serve` runs the services: an error of their start is one line there
        timeout_graceful_shutdown=GRACEFUL_S,
    )
