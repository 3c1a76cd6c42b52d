"""When the daily proof that the path works is due. Pure: local times in."""

from __future__ import annotations

from datetime import datetime


def heartbeat_due(before: datetime, now: datetime, minute_of_day: int) -> str:
    """The day of the heartbeat whose time has come since ``before``; empty where none has."""
    at = now.replace(hour=minute_of_day // 60, minute=minute_of_day % 60, second=0, microsecond=0)
    return now.date().isoformat() if before < at <= now else ""
