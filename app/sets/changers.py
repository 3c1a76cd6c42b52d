"""Who gave a parameter the value it has: one of us, or somebody at the panel."""

from __future__ import annotations

from app.audit.log import Event, EventLog
from app.audit.store import Filter
from app.sets.model import Row


async def who_changed(events: EventLog, bus: str, unit: int, number: int, row: Row | None) -> Event | None:
    """The event of our write that left ``row`` as it is; None when it was changed at the panel."""
    wanted = Filter(kind="command", bus=bus, unit=unit, search=f"#{number} ")
    found, _ = await events.page(wanted, 1)
    if not found or row is None or found[0]["new_raw"] != row.raw:
        return None
    return found[0] if found[0]["outcome"] in ("verified", "unverified") else None
