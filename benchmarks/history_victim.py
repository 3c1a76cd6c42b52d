"""A process to be killed: it stores 5,000 readings a second and some events, and prints its progress.

``python -m benchmarks.history_victim FOLDER``: each line is the number of an event that is on disk, and the
time of the newest reading that was taken in.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from app.core.database import Database
from app.line.history.service import History
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from bus.contract import Reading
from bus.instants import unix_now

KEY_FILE = "audit.key"
"""Beside the store: each victim goes on with the keys of the one before."""
UNITS = 130
A_SECOND = 5_000
STEP_S = 0.02
EVENTS_FROM_STEP = 5


async def _live(folder: Path) -> None:
    history = History(folder / "flood")
    store = folder / "flood" / "lineside.db"
    database = Database(store)
    keys = open_keys([store.with_name(KEY_FILE)], store, database.read_now(heads_of))
    events = EventLog(database, keys=keys)
    history.start()
    step = 0
    while True:
        now = unix_now()
        count = round(A_SECOND * STEP_S)
        batch = [
            Reading(1 + (step * count + i) % UNITS, now, 1000, 1000 + (step + i) % 9, 128, 0xC0, 3)
            for i in range(count)
        ]
        history.append("line", batch)
        step += 1
        if step % EVENTS_FROM_STEP == 0:
            number = await events.record(
                kind="mode", what="mode", bus="line", unit=1, old="LOCAL", new="REMOTE"
            )
            print(number, now, flush=True)
        await asyncio.sleep(max(0.0, STEP_S - (unix_now() - now)))


if __name__ == "__main__":
    asyncio.run(_live(Path(sys.argv[1])))
