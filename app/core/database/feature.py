"""The main store, and the disk space that is kept for it."""

from __future__ import annotations

import asyncio
from functools import partial

from app.core.database import Database
from app.core.database.files import Reserve, make_private
from app.feature import Feature, Services


def make(services: Services) -> None:
    """Open the store, which closes last, after the event of the server's end. Raise StoreError."""
    server, lifespan = services.settings.server, services.lifespan
    make_private(server.data)
    reserve = services.add(Reserve(server.data))
    lifespan.add("disk reserve", end=partial(asyncio.to_thread, reserve.close))
    database = services.add(Database(server.store, reserve=reserve))
    lifespan.add("store", end=partial(asyncio.to_thread, database.close))


FEATURE = Feature(make)
