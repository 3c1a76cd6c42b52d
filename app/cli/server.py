"""Uvicorn as the dashboard wants it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, cast

import uvicorn

from app.cli.frames import FramesProtocol
from app.cli.loop_watch import LoopWatch
from app.cli.stamping import StampingProtocol
from app.main import create_app
from app.settings import Settings

GRACEFUL_S = 1
"""What requests in flight get when the server ends."""
DATE_EVERY_S = 1.0
MOST_MESSAGE_BYTES = 4 * 1024 * 1024


class Server(uvicorn.Server):
    """Leaves the signals to the host, and says when it serves."""

    def __init__(
        self, settings: Settings, demo: bool, worker_tokens: Mapping[str, str], serving: Callable[[], None]
    ) -> None:
        self._watch = LoopWatch()
        app = create_app(settings, demo=demo, worker_tokens=worker_tokens)
        super().__init__(_config(app, self._watch))
        self._serving = serving
        self._ended = asyncio.Event()

    def end(self) -> None:
        """Let go of everybody, then return from serving."""
        self.should_exit = True
        self._ended.set()

    def capture_signals(self) -> Any:
        """The workers must end before the server does."""
        return nullcontext()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """As it is, then the word that it serves."""
        self._watch.start()
        await super().startup(sockets)
        if self.started:
            self._serving()

    async def main_loop(self) -> None:
        """Once a second for the header ``Date``: uvicorn's own looks ten times whether it shall end."""
        while not await self.on_tick(0):
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ended.wait(), DATE_EVERY_S)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """As it is; the loop is watched no more."""
        self._watch.stop()
        await super().shutdown(sockets)


def _config(app: Any, watch: LoopWatch) -> uvicorn.Config:
    """No deflate on WebSockets: at ten messages a second it costs a quarter of a core, and every page would
    need frames of its own."""
    return uvicorn.Config(
        app,
        loop="none",
        http=cast(type[asyncio.Protocol], partial(StampingProtocol, watch=watch)),
        ws=FramesProtocol,
        ws_per_message_deflate=False,
        ws_max_size=MOST_MESSAGE_BYTES,
        access_log=False,
        log_level="warning",
        server_header=False,
        lifespan="on",
        timeout_graceful_shutdown=GRACEFUL_S,
    )
