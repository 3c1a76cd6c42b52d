"""The notice of a database that is away, for the head of every page."""

from __future__ import annotations

from app.database.availability import Availability
from app.web.rendering.formats import Formats
from bus.instants import UnixTime
from bus.messages import Message


def away_notice(availability: Availability, formats: Formats, now: UnixTime) -> Message | None:
    """Since when the database is away, what works meanwhile and what does not; None while it is there."""
    if availability.away_since is None:
        return None
    return Message.of("store_away_notice", time=formats.since(availability.away_since, now))
