"""The events that explain a curve, and the spans of readings that came late, as marks of a chart."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from operator import attrgetter
from typing import Any, NamedTuple

from app.audit.log import Event, EventLog
from app.audit.queries import Filter
from app.messages import Language
from app.web.api.shape import iso, message_shown
from bus.instants import UnixTime

MAX_MARKS = 500
MARK_KINDS = frozenset({"command", "mode", "estop", "run", "unit", "bus", "worker", "server", "clock"})
"""Events that explain a curve; sign-ins do not."""
LATE = ("event_history_follows", "event_readings_late")
"""Events about readings that came late: the message has the span of these."""
_TEXTS = ("what", "old", "new")
"""The fields of a mark that may be messages."""
_OF_MARK = ("id", "kind", "who", "bus", "unit", "outcome", *_TEXTS)


class Mark(NamedTuple):
    """An event and its place in a chart; ``until``: the end of a span, None for a moment."""

    at: UnixTime
    until: UnixTime | None
    event: Event


async def marks_of(
    events: EventLog, start: UnixTime, end: UnixTime, units: Sequence[str] | None
) -> tuple[list[Mark], bool]:
    """The marks of a span, oldest first, and whether there were more events. ``units``: the site and these,
    each ``bus/unit``; empty: all. Raises StoreError."""
    found, after = await events.page(Filter(since=start, until=end), MAX_MARKS)
    marks = [Mark(event["time"], None, event) for event in found if _explains(event, units)]
    for code in LATE:
        # Readings come after their time, perhaps long after.
        late, _ = await events.page(Filter(since=start, code=code), MAX_MARKS)
        spans = (Mark(_time(event, "since"), _time(event, "until"), event) for event in late)
        marks += [mark for mark in spans if mark.at < end and start <= (mark.until or mark.at)]
    return sorted(marks, key=attrgetter("at")), after is not None


def shown_mark(mark: Mark, times: str, language: Language) -> dict[str, Any]:
    """A mark as the API returns it; ``times``: iso or epoch."""
    event = mark.event
    messages = {name: event["messages"][name] for name in _TEXTS if name in event["messages"]}
    texts = {name: event[name] for name in _TEXTS if event[name]}
    return {
        **{name: event[name] for name in _OF_MARK},
        "t": time_shown(mark.at, times),
        "until": None if mark.until is None else time_shown(mark.until, times),
        "messages": {name: message_shown(message) for name, message in messages.items()},
        "shown": texts | {name: language.t(messages[name]) for name in messages.keys() & texts},
    }


def time_shown(at: UnixTime, times: str) -> str | UnixTime:
    """A time as ISO 8601 or, with ``times`` epoch, in seconds."""
    return at if times == "epoch" else iso(at)


def _explains(event: Event, units: Sequence[str] | None) -> bool:
    is_of_chosen = event["unit"] is None or not units or f"{event['bus']}/{event['unit']}" in units
    return event["kind"] in MARK_KINDS and is_of_chosen and not _is_late(event)


def _is_late(event: Event) -> bool:
    return "what" in event["messages"] and event["messages"]["what"].code in LATE


def _time(event: Event, name: str) -> UnixTime:
    return UnixTime(datetime.fromisoformat(str(event["messages"]["what"].params[name])).timestamp())
