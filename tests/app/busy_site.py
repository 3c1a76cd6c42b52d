"""A site that is written without end, as a process that a test kills: events, readings and pictures."""

from __future__ import annotations

import asyncio
import secrets
import sys
import time
from pathlib import Path

from app.core.database import Database
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from app.records.handover.notes import MIGRATIONS
from app.settings import load
from tests.app.history_line import BUS, opened, polls


def make_site(folder: Path) -> Path:
    """Make a site with its stores and its key; return its configuration."""
    config = folder / "lineside.toml"
    config.write_text('[server]\ndata = "data"\n')
    data = load(config).server.data
    Database(data / "pictures.db", MIGRATIONS).close()
    opened(data).close()
    asyncio.run(_write(config, 1))
    return config


async def _write(config: Path, turns: int | None = None) -> None:
    settings = load(config)
    data = settings.server.data
    main, pictures = Database(data / "lineside.db"), Database(data / "pictures.db", MIGRATIONS)
    events = EventLog(main, keys=open_keys(settings.key_files, main.path, main.read_now(heads_of)))
    history = opened(data)
    start = time.time() - 4 * 3600
    while turns is None or turns:
        turns = None if turns is None else turns - 1
        history.enqueue((BUS.name, polls(start, start + 240)))
        start += 240
        await events.record(kind="unit", what="offline", bus=BUS.name, unit=1)
        row = (secrets.token_hex(32), "image/png", secrets.token_bytes(3000))
        await pictures.write(lambda c, row=row: c.execute("INSERT INTO picture VALUES (?, ?, ?)", row))  # type: ignore[misc]
        await asyncio.sleep(0.1)
    history.close()
    main.close()
    pictures.close()


if __name__ == "__main__":
    asyncio.run(_write(Path(sys.argv[1])))
