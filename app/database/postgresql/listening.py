"""What transactions of all servers notify, passed on to the event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import psycopg
import structlog
from psycopg.sql import SQL, Identifier

from app.database.database import Listener
from app.errors import StoreError

LOOK_S = 0.2
"""How long the end, or a further channel, waits at most."""
RETRY_S = 1.0
MAX_END_S = 1.0
log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class _Channel:
    name: str
    loop: asyncio.AbstractEventLoop
    callback: Listener

    def pass_on(self, text: str) -> None:
        # A loop that has ended needs no more news.
        with suppress(RuntimeError):
            self.loop.call_soon_threadsafe(self.callback, text)


class Listening:
    """A connection and its thread. A lost connection is opened again, and each listener has an empty text."""

    def __init__(self, connect: Callable[[], psycopg.Connection[object]], label: str) -> None:
        self._connect = connect
        self._channels: tuple[_Channel, ...] = ()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{label}-listener", daemon=True)

    def add(self, channel: str, callback: Listener) -> None:
        """Call ``callback`` on the running event loop with each text of the channel."""
        self._channels += (_Channel(channel, asyncio.get_running_loop(), callback),)
        if not self._thread.is_alive():
            self._thread.start()

    def close(self) -> None:
        self._ending.set()
        if self._thread.is_alive():
            # It may be in the middle of a connection to a server that does not respond.
            self._thread.join(MAX_END_S)

    def _run(self) -> None:
        was_lost = False
        while not self._ending.is_set():
            try:
                with self._connect() as driver:
                    self._follow(driver, is_back=was_lost)
            except (psycopg.Error, StoreError) as error:
                if not was_lost:
                    log.warning("notifications of the database lost; retrying", error=str(error))
                was_lost = True
                self._ending.wait(RETRY_S)

    def _follow(self, driver: psycopg.Connection[object], *, is_back: bool) -> None:
        listened: tuple[_Channel, ...] = ()
        while not self._ending.is_set():
            if new := self._channels[len(listened) :]:
                for channel in new:
                    driver.execute(SQL("LISTEN {}").format(Identifier(channel.name)))
                listened += new
                for channel in new if is_back else ():
                    channel.pass_on("")
                is_back = False
            for notice in driver.notifies(timeout=LOOK_S):
                for channel in listened:
                    if channel.name == notice.channel:
                        channel.pass_on(notice.payload)
