"""The pictures of notes, in a store beside the main one: a large write does not delay a command."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import structlog

from app.core.database import Database, StoreConnection
from app.core.database.connection import size_of
from app.errors import Problem, StoreError
from app.records.handover.rules.pictures import PlainPicture, plain_picture
from bus.messages import Message

log = structlog.get_logger()

FILE = "pictures.db"
MIGRATIONS = Path(__file__).parent / "migrations"
MAX_OF_NOTE = 3
MAX_PICTURE_BYTES = 1024**2
"""Bytes of one picture."""
MB = 1_000_000


def judged(contents: Sequence[bytes]) -> dict[str, PlainPicture]:
    """Return the pictures by the SHA-256 of what is kept of them. Raises Problem 422, CallerError."""
    if len(contents) > MAX_OF_NOTE:
        raise Problem(422, "invalid", Message.of("pictures_too_many", n=MAX_OF_NOTE))
    if any(len(content) > MAX_PICTURE_BYTES for content in contents):
        raise Problem(413, "too_large", Message.of("picture_too_long", n=MAX_PICTURE_BYTES // 1024**2))
    plain = [plain_picture(content) for content in contents]
    return {hashlib.sha256(each.content).hexdigest(): each for each in plain}


class PictureStore:
    """The store is opened with the first picture: most sites have none."""

    def __init__(self, folder: Path, max_mb: int) -> None:
        self._path = folder / FILE
        self._max_mb = max_mb
        self._opening = asyncio.Lock()
        self._database: Database | None = None

    async def add(self, pictures: dict[str, PlainPicture]) -> None:
        """Store pictures that are not there yet. Raises Problem 409 where there is no room for them."""
        rows = [(digest, each.media_type, each.content) for digest, each in pictures.items()]
        if rows:
            database = await self._opened()
            await database.write(lambda connection: self._insert(connection, rows))

    def _insert(self, connection: StoreConnection, rows: Sequence[tuple[str, str, bytes]]) -> None:
        if size_of(connection) + sum(len(content) for _, _, content in rows) > self._max_mb * MB:
            raise Problem(409, "too_many", Message.of("pictures_of_site_full", n=self._max_mb))
        query = "INSERT INTO picture VALUES (?, ?, ?) ON CONFLICT (digest) DO NOTHING"
        connection.executemany(query, rows)

    async def find(self, digest: str) -> PlainPicture:
        """Raises Problem 404, also for one that is not what its digest names; StoreError where the store is
        damaged."""
        query = "SELECT media_type, content FROM picture WHERE digest = ?"
        row = None
        if self._path.exists():
            database = await self._opened()
            row = await database.read(lambda store: store.execute(query, (digest,)).fetchone())
        if row is None or hashlib.sha256(row["content"]).hexdigest() != digest:
            raise Problem(404, "not_found", Message("no_such_picture"))
        return PlainPicture(*row)

    async def all_of(self, digests: Iterable[str]) -> dict[str, PlainPicture]:
        """Return the pictures of these digests that can be read. Damage costs only the pictures that it is
        in."""
        found = {}
        for digest in digests:
            try:
                found[digest] = await self.find(digest)
            except Problem:
                continue
            except StoreError as error:
                log.error("store", picture=digest, error=str(error))
        return found

    def close(self) -> None:
        if self._database is not None:
            self._database.close()

    async def _opened(self) -> Database:
        async with self._opening:
            if self._database is None:
                self._database = await asyncio.to_thread(Database, self._path, MIGRATIONS)
            return self._database
