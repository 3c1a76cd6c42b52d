"""Who gave a parameter its value: a user, or a person at the panel."""

from __future__ import annotations

from app.audit.log import Event, EventLog
from app.audit.store import Filter
from app.sets.compare import Compared
from bus.catalogue.parameters import PARAMETERS

_ACTED = ("verified", "acknowledged", "unverified", None)
"""Outcomes after which the unit may have taken the value; None: it was read before the outcome was stored."""
_LOOK_BACK = 20
"""Refused commands are among them: so many newest events of a parameter are examined."""


async def who_changed(events: EventLog, bus: str, unit: int, row: Compared) -> Event | None:
    """The event of our write, later than the reading of the left side (the golden set), that left the
    right side as it is; None when it was changed at the panel."""
    since = None if row.left is None else row.left.read_at
    wanted = Filter(
        kind="command", bus=bus, unit=unit, since=since, code="event_write_parameter", number=row.number
    )
    found, _ = await events.page(wanted, _LOOK_BACK)
    last = next((event for event in found if event["outcome"] in _ACTED), None)
    if row.right is None:
        return None
    if last is None:
        return await _older(events, bus, unit, row)
    # A secret is in no event: only its last write can be named.
    known = PARAMETERS[row.number].secret or last["new_raw"] == row.right.raw
    return last if known else None


async def _older(events: EventLog, bus: str, unit: int, row: Compared) -> Event | None:
    """A command of a version that stored no parameter number: the one from the left value to the right."""
    if row.left is None or row.right is None or row.left.raw is None or row.right.raw is None:
        return None
    wanted = Filter(
        kind="command",
        bus=bus,
        unit=unit,
        since=row.left.read_at,
        old_raw=row.left.raw,
        new_raw=row.right.raw,
    )
    found, _ = await events.page(wanted, _LOOK_BACK)
    return next((event for event in found if not event["messages"] and event["outcome"] in _ACTED), None)
