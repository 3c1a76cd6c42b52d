"""Passes the summaries of the lines of this server on to all servers of the site, once a second."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence

import structlog

from app.database import Database, StoreConnection
from app.database.connection import notify
from app.errors import StoreError
from app.sites.own_lines import OwnLines
from app.sites.summary import end_notice, notices

CHANNEL = "lineside_lines"
EVERY_S = 1.0
Notify = Callable[[Sequence[str]], Awaitable[None]]
"""Passes texts to every server. Raises StoreError."""
_log = structlog.get_logger()


class SummaryPublisher:
    """While the store is away, the lines of this server are stale on the others."""

    def __init__(self, own: OwnLines, notify: Notify) -> None:
        self._own = own
        self._notify = notify
        self._fault = ""

    async def publish(self) -> None:
        """Run until canceled."""
        while True:
            await self._send([*notices(self._own.homes.server, self._own.summaries())])
            await asyncio.sleep(EVERY_S)

    async def end(self) -> None:
        """This server stops: its lines are not reported any more."""
        await self._send([end_notice(self._own.homes.server)])

    async def _send(self, texts: list[str]) -> None:
        try:
            if texts:
                await self._notify(texts)
            self._fault = ""
        except StoreError as error:
            if str(error) != self._fault:
                _log.warning("summaries not published", why=str(error))
            self._fault = str(error)


async def notify_lines(database: Database, texts: Sequence[str]) -> None:
    """Pass texts to every server of a store. Raises StoreError."""

    def pass_on(connection: StoreConnection) -> None:
        for text in texts:
            notify(connection, CHANNEL, text)

    await database.write(pass_on)
