"""When the alarms were observed, and how much of a span. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bus.instants import UnixTime

MAX_GAP_S = 60.0
"""The engine looks every second. After a longer gap it stood still, or the clock was set."""


class ObservedSpan(NamedTuple):
    """Alarms were observed from ``start`` to ``end``."""

    start: UnixTime
    end: UnixTime


def observed_until(now: UnixTime, former: ObservedSpan | None) -> ObservedSpan:
    """The former span with the time up to ``now``; another one, where ``now`` does not follow it."""
    if former is None or not 0 <= now - former.end <= MAX_GAP_S:
        return ObservedSpan(now, now)
    return former._replace(end=now)


def observed_within(spans: Iterable[ObservedSpan], start: UnixTime, end: UnixTime) -> list[ObservedSpan]:
    """What of a time was observed: without overlaps, in order."""
    found: list[ObservedSpan] = []
    for span in sorted(ObservedSpan(max(each.start, start), min(each.end, end)) for each in spans):
        if span.start >= span.end:
            continue
        if found and span.start <= found[-1].end:
            found[-1] = found[-1]._replace(end=max(found[-1].end, span.end))
        else:
            found.append(span)
    return found
