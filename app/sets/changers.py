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
    wanted = Filter(kind="command", bus=bus, unit=unit, since=since, search=f"#{row.number} ")
    found, _ = await events.page(wanted, _LOOK_BACK)
    ours = (event for event in found if _writes(event, row.number) and event["outcome"] in _ACTED)
    last = next(ours, None)
    if last is None or row.right is None:
        return None
    # A secret is in no event: only its last write can be named.
    known = PARAMETERS[row.number].secret or last["new_raw"] == row.right.raw
    return last if known else None


def _writes(event: Event, number: int) -> bool:
    what = event["messages"].get("what")
    if what is None:  # an event of a version that stored texts only
        text: str = event["what"]
        return f"write #{number} " in text
    is_write: bool = what.code == "event_write_parameter" and what.params.get("number") == number
    return is_write
