"""Events drawn beside the values, setpoint changes among them."""

from __future__ import annotations

from typing import Any

from app.audit.log import Event, EventLog
from app.audit.store import Filter
from app.history.api.spans import Span
from app.history.service import seconds

MOST = 500
KINDS = frozenset({"command", "mode", "estop", "run", "unit", "bus", "worker", "server", "clock"})
"""What explains a curve. Who signed in does not."""
_SHOWN = ("id", "kind", "what", "who", "bus", "unit", "old", "new", "outcome", "messages")


async def collect_marks(events: EventLog, span: Span, units: list[str]) -> tuple[list[dict[str, Any]], bool]:
    """Marks oldest first, and whether there were more than fit."""
    wanted = Filter(since=seconds(span.start), until=seconds(span.end))
    found, after = await events.page(wanted, MOST)
    marks = [{"t": event["time"], **{name: event[name] for name in _SHOWN}} for event in found]
    return [mark for mark in reversed(marks) if _concerns(mark, units)], after is not None


def _concerns(event: Event, units: list[str]) -> bool:
    """Of the site, of a bus, or of a unit that is shown."""
    of_these = event["unit"] is None or not units or f"{event['bus']}/{event['unit']}" in units
    return event["kind"] in KINDS and of_these
