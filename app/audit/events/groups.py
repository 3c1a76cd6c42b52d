"""Which events are parts of one change of several units, so that a page can show them as one row."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from app.audit.events.store import Filter
from app.audit.log import Event, EventLog
from app.database import StoreConnection

MAX_PARTS = 1000
"""Parts that one page holds; with more there are fewer rows on it. A change has at most 255."""


@dataclass(frozen=True, slots=True)
class EventRow:
    """One row of the events page: an event, with the parts of a change of several units by address."""

    event: Event
    parts: list[Event] = field(default_factory=list)

    @property
    def outcomes(self) -> list[tuple[str | None, int]]:
        """How many parts have which outcome, the most frequent first; None while it is not known."""
        return Counter(part["outcome"] for part in self.parts).most_common()


def link_parts(connection: StoreConnection, count: int) -> None:
    """Note that the last ``count`` events are parts of the one before; in the transaction that wrote them."""
    [last] = connection.execute("SELECT max(id) FROM events").fetchone()
    rows = [(number, last - count) for number in range(last - count + 1, last + 1)]
    connection.executemany("INSERT INTO event_parts (event, change) VALUES (?, ?)", rows)


async def page(events: EventLog, wanted: Filter, limit: int) -> tuple[list[EventRow], int | None]:
    """Rows newest first, at most ``limit``, and the number to continue from (None at the end). A part is a
    row where the filter leaves its group out."""
    found, after = await events.page(replace(wanted, folded=True), limit)
    groups = sorted(event["id"] for event in found)
    parts, more = await events.page(Filter(parts_of=tuple(groups)), MAX_PARTS)
    by_group: dict[int, list[Event]] = {}
    for part in reversed(parts):
        by_group.setdefault(_group_of(part, groups), []).append(part)
    if more is not None:
        # Newest first: the change of the last part may have more than were read; newer ones have all.
        cut = _group_of(parts[-1], groups)
        found, after = [event for event in found if event["id"] > cut], cut + 1
    return [EventRow(event, by_group.get(event["id"], [])) for event in found], after


def _group_of(part: Event, ordered: Sequence[int]) -> int:
    """The parts of a change stand right behind it."""
    return ordered[bisect_left(ordered, part["id"]) - 1]
