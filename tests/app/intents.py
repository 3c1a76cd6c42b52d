"""A command as an event, without one that is sent."""

from __future__ import annotations

from typing import Any

from app.people.audit.log import EventLog


async def intend(events: EventLog, **members: Any) -> int:
    """The number of its event."""
    return (await events.intend_together([members]))[0]
