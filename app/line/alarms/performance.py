"""Figures of the alarm system and their targets (ISA-18.2-2016, clause 16), and how fast alarms come.

Pure: counts and times are passed in.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Literal, NamedTuple

from pydantic import Field
from typing_extensions import TypeAliasType

from app.line.conditions.condition import PRIORITIES, AlarmPriority
from bus.instants import DAY_S, UnixTime

WINDOW_S = 600
"""Rates are measured in ten minutes, which slide along."""
MANY = 10
"""The alarms in a window above which a flood begins: a person cannot respond to them."""
FEW = 5
"""The alarms in a window below which a flood is over."""
CHATTERS_S = 60.0
"""The seconds within which an alarm comes three times if it chatters."""
FLEETING_S = 10.0
"""The seconds within which an alarm clears, before a person could act, if it is fleeting."""
STALE_S = 24 * 3600.0
"""An alarm that stays active for more seconds is stale."""
MIN_FOR_TOP_TEN = 200
"""Of fewer annunciated alarms, ten are more than 5 % in any case: their share has no value."""

FigureCode = Literal[
    "annunciated",
    "per_day",
    "per_10_minutes",
    "peak_10_minutes",
    "windows_over_10",
    "flood_share",
    "top_ten_share",
    "chattering",
    "fleeting",
    "stale",
    "standing",
    "shelved",
    "suppressed",
    "out_of_service",
    "urgent_share",
    "high_share",
    "medium_share",
    "low_share",
    "acknowledge_median_s",
]
AlarmFigureCode = TypeAliasType("AlarmFigureCode", FigureCode)
FigureTarget = Annotated[float | None, Field(description="Its target; null: none of this kind.")]
AT_MOST: dict[FigureCode, float] = {
    "per_day": 144,
    "per_10_minutes": 1,
    "peak_10_minutes": MANY,
    "windows_over_10": 0.01,
    "flood_share": 0.01,
    "top_ten_share": 0.05,
    "chattering": 0,
    "fleeting": 0,
    "stale": 4,
    "urgent_share": 0.01,
    "high_share": 0.05,
    "medium_share": 0.15,
    "acknowledge_median_s": WINDOW_S,
}
AT_LEAST: dict[FigureCode, float] = {"low_share": 0.8}


@dataclass(frozen=True, slots=True)
class AlarmFigure:
    """A figure and its target."""

    code: AlarmFigureCode
    value: Annotated[
        float | None,
        Field(description="Shares 0 to 1; null: nothing to measure, or under 10 minutes were observed."),
    ]
    at_most: FigureTarget
    at_least: FigureTarget
    met: Annotated[bool | None, Field(description="Whether it keeps its target; null: it has none.")]


def judged(code: FigureCode, value: float | None) -> AlarmFigure:
    """Return a figure against its target; ``value`` is None if there was nothing to measure."""
    at_most, at_least = AT_MOST.get(code), AT_LEAST.get(code)
    met = None
    if value is not None and (at_most is not None or at_least is not None):
        met = (at_most is None or value <= at_most) and (at_least is None or value >= at_least)
    return AlarmFigure(code, value, at_most, at_least, met)


class AlarmPace(NamedTuple):
    """How many alarms came, the most within ten minutes, and the seconds with more than ten in the ten
    minutes before, and in floods: from more than ten until fewer than five."""

    total: int
    peak: int
    over_s: float
    flood_s: float


def pace_of(came: Iterable[float], end: float) -> AlarmPace:
    """Return the pace of alarms until ``end`` by ten minutes that slide along, as `AlarmRates` counts them.
    ``came``: when each came, in order."""
    window: deque[float] = deque()
    total, peak, over_s, flood_s, is_flood, since = 0, 0, 0.0, 0.0, False, 0.0
    for at in chain(came, (end,)):
        peak = max(peak, len(window))
        while True:
            expires = window[0] + WINDOW_S if window else at
            until = min(at, expires)
            is_flood = len(window) > MANY or (is_flood and len(window) >= FEW)
            over_s += (until - since) * (len(window) > MANY)
            flood_s += (until - since) * is_flood
            since = until
            if not window or expires > at:
                break
            window.popleft()
        window.append(at)
        total += 1
    return AlarmPace(total - 1, peak, over_s, flood_s)


@dataclass(frozen=True, slots=True)
class AlarmCounts:
    """The counts of the journal over a span in which alarms were observed for ``observed_s``, and the present
    states. ``top_ten``: how often the ten most frequent alarms came."""

    observed_s: float
    pace: AlarmPace
    top_ten: int
    of_priority: Mapping[AlarmPriority, int]
    chattering: int
    fleeting: int
    acknowledge_median_s: float | None
    now: Mapping[FigureCode, int]


def figures(measured: AlarmCounts) -> list[AlarmFigure]:
    """Return every figure, in the order in which they are shown. Before ten minutes were observed the journal
    gives none: that no alarm came while none was looked for meets no target."""
    found = _measured(measured)
    if measured.observed_s < WINDOW_S:
        found = {**dict.fromkeys(found), **measured.now}
    return [judged(code, value) for code, value in found.items()]


def _measured(measured: AlarmCounts) -> dict[FigureCode, float | None]:
    total, peak, over_s, flood_s = measured.pace
    observed_s = max(WINDOW_S, measured.observed_s)
    windows = observed_s / WINDOW_S
    return {
        "annunciated": total,
        "per_day": total / windows * DAY_S / WINDOW_S,
        "per_10_minutes": total / windows,
        "peak_10_minutes": peak,
        "windows_over_10": min(1.0, over_s / observed_s),
        "flood_share": min(1.0, flood_s / observed_s),
        "top_ten_share": _share(measured.top_ten, total) if total >= MIN_FOR_TOP_TEN else None,
        "chattering": measured.chattering,
        "fleeting": measured.fleeting,
        **measured.now,
        **{
            f"{priority}_share": _share(measured.of_priority.get(priority, 0), total)  # type: ignore[misc]
            for priority in PRIORITIES
        },
        "acknowledge_median_s": measured.acknowledge_median_s,
    }


def _share(part: int, total: int) -> float | None:
    return part / total if total else None


RISES_OF_CHATTER = 3
MAX_COUNTED = 1000
"""The most alarms that are counted in ten minutes; the oldest beyond it are left out."""


class AlarmRates:
    """The alarms annunciated in the last ten minutes, in order."""

    def __init__(self) -> None:
        self._came: deque[UnixTime] = deque(maxlen=MAX_COUNTED)
        self._of_alarm: dict[str, deque[UnixTime]] = {}
        self._is_flood = False

    def note(self, alarm: str, at: UnixTime) -> None:
        """Count the annunciation of an alarm, by its key; one that is counted already counts once."""
        rises = self._of_alarm.setdefault(alarm, deque(maxlen=RISES_OF_CHATTER))
        if rises and rises[-1] == at:
            return
        rises.append(at)
        self._came.append(at)
        self.count(at)

    def count(self, now: UnixTime) -> int:
        """Count the alarms annunciated in the last ten minutes. A clock that was set back forgets them."""
        while self._came and not 0 <= now - self._came[0] < WINDOW_S:
            self._came.popleft()
        found = len(self._came)
        self._is_flood = found > MANY or (self._is_flood and found >= FEW)
        return found

    def flood(self, now: UnixTime) -> int:
        """Count the alarms of the last ten minutes in a flood: from more than ten on, until there are fewer
        than five. Return 0 without a flood."""
        count = self.count(now)
        return count if self._is_flood else 0

    def chatters(self, alarm: str, now: UnixTime) -> bool:
        """Return whether an alarm came three times within a minute, the last time in the last ten minutes."""
        rises = self._of_alarm.get(alarm)
        if rises is None or len(rises) < RISES_OF_CHATTER or not 0 <= now - rises[-1] < WINDOW_S:
            return False
        return 0 <= rises[-1] - rises[0] <= CHATTERS_S


MAX_GAP_S = 60.0
"""The longest gap of one span in seconds. After a longer one the server stood still, or the clock was set."""


class ObservedSpan(NamedTuple):
    """A time in which alarms were observed."""

    start: UnixTime
    end: UnixTime


def observed_until(now: UnixTime, former: ObservedSpan | None) -> ObservedSpan:
    """Return the former span extended to ``now``, or a new one if ``now`` does not follow the former."""
    if former is None or not 0 <= now - former.end <= MAX_GAP_S:
        return ObservedSpan(now, now)
    return former._replace(end=now)


def observed_within(spans: Iterable[ObservedSpan], start: UnixTime, end: UnixTime) -> list[ObservedSpan]:
    """Return the observed parts of a time, without overlaps, in order."""
    found: list[ObservedSpan] = []
    for span in sorted(ObservedSpan(max(each.start, start), min(each.end, end)) for each in spans):
        if span.start >= span.end:
            continue
        if found and span.start <= found[-1].end:
            found[-1] = found[-1]._replace(end=max(found[-1].end, span.end))
        else:
            found.append(span)
    return found
