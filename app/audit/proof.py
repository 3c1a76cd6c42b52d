"""Proving the log of a running server, without holding anything up."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Mapping

from app.audit import store
from app.audit.chain import Head
from app.audit.keys import Keys
from app.audit.walk import Verdict, Walk
from app.database import Database


class LogProof:
    """Reads the log chunk by chunk in a thread: neither the event loop nor the store's checkpoint waits until
    all of a long log is read."""

    def __init__(self, database: Database, keys: Keys) -> None:
        self._database = database
        self._keys = keys
        self._one_at_a_time = asyncio.Lock()

    async def verify(self, anchors: Mapping[int, str] | None = None) -> Verdict:
        """Whether the log is intact, and holds the hashes that ``anchors`` names by entry."""
        async with self._one_at_a_time:
            head, last = await self.extent()
            walk = Walk(self._keys.knowing(head.key), anchors)
            await self._follow(walk, store.LOWEST_ID, last)
            return walk.end(head)

    async def since(self, known: Head) -> Verdict:
        """Whether what was added after an entry that is known to be good continues it."""
        head, last = await self.extent()
        walk = Walk(self._keys.knowing(head.key), start=known)
        await self._follow(walk, known.id + 1 if known.id else store.LOWEST_ID, last)
        return walk.end(head)

    async def extent(self) -> tuple[Head, int]:
        """The entry noted as the newest, and the number of the last one stored."""
        return await self._database.read(store.extent)

    async def link(self, number: int) -> Head | None:
        """One entry as the next one continues it, None where there is none."""
        return await self._database.read(lambda connection: store.link_of(connection, number))

    async def _follow(self, walk: Walk, number: int, until: int) -> None:
        def follow_chunk(connection: sqlite3.Connection) -> int | None:
            chunk = store.entries_from(connection, number, until)
            walk.follow(chunk)
            return chunk[-1]["id"] + 1 if chunk and walk.broken is None else None

        while (following := await self._database.read(follow_chunk)) is not None:
            number = following
            await asyncio.sleep(0)
