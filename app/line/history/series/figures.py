"""The points of a chart, and the figures of a unit for reports. Pure.

Any number of readings become at most so many points, with the least, greatest and average value of a bucket.
The buckets lie on a grid of round widths that does not move with the span, so that the points of a chart stay
in their places when it is drawn again a second later.

The figures are how long a unit ran and was at speed, when and why it stood still, how far it went, and its
draw. It runs while its actual speed is not 0. It is at speed while it runs with a setpoint above 0 and
reports the bit *at speed* of ST2: its actual speed is within the window of parameter 12 around the commanded
one. A reading counts until the next one, or until the hole after it, which counts as neither.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, compress, count, pairwise
from operator import itemgetter, le, mul, ne, sub, truediv
from typing import Literal, NamedTuple

import msgspec

from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, Rollup, Run
from app.line.history.series.values import LONG_GAP, VALUES, Marks, Scaling, holes, usual_interval
from bus.catalogue.values import status_bits

_MS = 1000
WIDTHS = tuple(
    unit * factor
    for unit, factors in (
        (_MS, (1, 2, 5, 10, 20, 50, 100, 200, 500)),
        (SECOND, (1, 2, 5, 10, 15, 20, 30)),
        (MINUTE, (1, 2, 3, 5, 10, 15, 20, 30)),
        (HOUR, (1, 2, 3, 4, 6, 8, 12)),
        (DAY, (1, 2, 4, 7, 14, 28, 56, 91, 182, 364)),
    )
    for factor in factors
)
"""The round widths of a chart's spans, µs."""


@dataclass(slots=True)
class Points:
    """Readings or stretches in order of time, with raw values; ``weight`` is the number of readings."""

    at: list[int] = field(default_factory=list)
    least: list[int] = field(default_factory=list)
    greatest: list[int] = field(default_factory=list)
    total: list[int] = field(default_factory=list)
    weight: list[int] = field(default_factory=list)
    solid: list[bool] = field(default_factory=list)
    """Whether the value is known without a gap until the next point."""
    width: int = 0
    """The length of the stretch of each point, µs; 0 for single readings."""
    usual: int = 0
    """The usual interval between two responses of the unit, µs."""


@dataclass(slots=True)
class Series:
    """The points of a chart in display units; None is a hole."""

    at: list[int] = field(default_factory=list)
    least: list[float | None] = field(default_factory=list)
    greatest: list[float | None] = field(default_factory=list)
    average: list[float | None] = field(default_factory=list)


def downsample(points: Points, start: int, end: int, most: int) -> Points:
    """Reduce points to at most ``most`` buckets between ``start`` and ``end``, µs."""
    width, origin = grid(start, end, most, points.width or _MS)
    parts = _parts(points.at, origin, width)
    return Points(
        at=[max(points.at[i] - (points.at[i] - origin) % width, start) for i, _ in parts],
        least=[min(points.least[i:j]) for i, j in parts],
        greatest=[max(points.greatest[i:j]) for i, j in parts],
        total=[sum(points.total[i:j]) for i, j in parts],
        weight=[sum(points.weight[i:j]) for i, j in parts],
        solid=[points.solid[j - 1] for _, j in parts],
        width=width,
        usual=points.usual,
    )


def _parts(at: Sequence[int], origin: int, width: int) -> list[tuple[int, int]]:
    """Return the range of positions of each bucket that is not empty."""
    parts = []
    i, n = 0, len(at)
    while i < n:
        j = bisect_left(at, at[i] - (at[i] - origin) % width + width, i)
        parts.append((i, j))
        i = j
    return parts


def grid(start: int, end: int, most: int, least_width: int = _MS) -> tuple[int, int]:
    """Return width and origin of at most ``most`` buckets over a span, µs, in round widths if possible."""
    for width in WIDTHS:
        if width % least_width == 0 and -(-end // width) - start // width <= most:
            return width, 0
    return max(least_width, -(-(end - start) // most)), start


def series(points: Points, marks: Marks, scaling: Scaling) -> Series:
    """Convert points to display units, and insert the holes."""
    result = Series(points.at)
    for i, j, scale in scaling.stretches(points.at):
        low, high = scale.apply_all(points.least[i:j]), scale.apply_all(points.greatest[i:j])
        middle = scale.apply_all(map(truediv, points.total[i:j], points.weight[i:j]))
        result.least += high if scale.falling else low
        result.greatest += low if scale.falling else high
        # Where nothing moved, the exact value and not its divided sum.
        result.average += [a if a == b else round(m, 6) for a, b, m in zip(low, high, middle, strict=True)]
    return _opened(result, holes_in(points, marks), points.width)


def _opened(series: Series, after: Sequence[int], width: int) -> Series:
    """Insert None between the points of each hole."""
    if not after:
        return series
    times = [series.at[i] + max(width, (series.at[i + 1] - series.at[i]) // 2) for i in after]
    at, nothing = series.at + times, [None] * len(times)
    ordered = itemgetter(*sorted(range(len(at)), key=at.__getitem__))
    least, greatest = ordered(series.least + nothing), ordered(series.greatest + nothing)
    return Series(list(ordered(at)), list(least), list(greatest), list(ordered(series.average + nothing)))


def holes_in(points: Points, marks: Marks) -> list[int]:
    """Return the positions of points before a hole."""
    found = holes(points.at, marks, points.usual, points.width)
    return [i for i in found if not points.solid[i]]


def in_order(points: Points) -> Points:
    """Sort points by time: two stretches overlap if a clock was set back or a minute came late."""
    if all(map(le, points.at, points.at[1:])):
        return points
    order = sorted(range(len(points.at)), key=points.at.__getitem__)
    columns = (points.at, points.least, points.greatest, points.total, points.weight)
    at, least, greatest, total, weight = ([column[i] for i in order] for column in columns)
    solid = [points.solid[i] for i in order]
    return Points(at, least, greatest, total, weight, solid, points.width, points.usual)


StopCause = Literal["estop", "run_off", "speed_zero", "unknown"]
_AT_SPEED = 1 << VALUES["at_speed"].bit


MOMENT = SECOND
"""The shortest movement that ends a stop, µs. Two stops with a shorter movement between them are one stop,
because the displayed speed swings about zero as a unit comes to rest."""


class Stop(msgspec.Struct, array_like=True):
    """A standstill from ``at`` until ``until``, µs, with the cause that its first reading shows."""

    at: int
    until: int
    cause: StopCause


class RunFigures(msgspec.Struct, array_like=True):
    """The figures of a unit. ``known``: the time with readings; ``running``: the part of it in which it ran;
    ``at_speed``: the part of that at speed, all µs; ``travel``: speed times µs; ``fastest``: the greatest
    speed; ``by_minute``: whether a minute in which the unit started or stopped counts by its averages;
    ``began_stopped`` and ``ended_stopped``: whether it stood in the first and in the last reading."""

    known: int = 0
    running: int = 0
    at_speed: int = 0
    travel: float = 0.0
    fastest: float = 0.0
    stops: list[Stop] = []
    by_minute: bool = False
    began_stopped: bool = False
    ended_stopped: bool = False


class RunStretch(NamedTuple):
    """The motion of a unit from one time until another, µs, in raw values; ``actual`` is the average of the
    time."""

    at: int
    until: int
    commanded: int
    actual: float
    greatest: int
    word: int

    @property
    def is_at_speed(self) -> bool:
        return _is_at_speed(self)


class SpeedMinute(NamedTuple):
    """The part of the summary of a minute (:class:`app.line.history.series.runs.Rollup`) that shows whether a
    unit ran and was at speed."""

    start: int
    readings: int
    commanded_min: int
    commanded_max: int
    actual_min: int
    actual_max: int
    actual_sum: int
    word_and: int
    word_or: int

    @property
    def is_steady(self) -> bool:
        """Whether all readings of the minute are runs at speed, or runs off speed, or a standstill with the
        same bits."""
        if self.actual_min <= 0 <= self.actual_max:
            return self.actual_min == self.actual_max and self.word_and == self.word_or
        is_commanded = self.commanded_min > 0 or self.commanded_max <= 0
        return is_commanded and not (self.word_and ^ self.word_or) & _AT_SPEED

    def stretch(self) -> RunStretch:
        """Return the minute by its averages: a unit that moved at all ran, and one that was at speed in every
        reading was at speed."""
        average = self.actual_sum / self.readings
        until = self.start + MINUTE
        return RunStretch(self.start, until, self.commanded_min, average, self.actual_max, self.word_and)


def _is_at_speed(run: Run | RunStretch) -> bool:
    return bool(run.actual and run.commanded > 0 and run.word & _AT_SPEED)


def run_figures(stretches: Sequence[RunStretch], estop_healthy: int, scales: Scaling) -> RunFigures:
    """Count the figures of a unit from its stretches in order of time, none of which contains a change of
    scale."""
    figures = RunFigures()
    is_standing = False
    for i, j, scale in scales.stretches([each.at for each in stretches]):
        for stretch in stretches[i:j]:
            at, until, _, raw, greatest, _ = stretch
            lasting = until - at
            figures.known += lasting
            was_standing, is_standing = is_standing, not raw
            if raw:
                figures.running += lasting
                figures.travel += scale.apply(raw) * lasting
                figures.fastest = max(figures.fastest, scale.apply(greatest))
                figures.at_speed += lasting if stretch.is_at_speed else 0
            elif figures.stops and (was_standing or at - figures.stops[-1].until < MOMENT):
                figures.stops[-1].until = until
            else:
                figures.stops.append(Stop(at, until, _cause(stretch, estop_healthy)))
    figures.began_stopped = bool(stretches) and not stretches[0].actual
    figures.ended_stopped = is_standing
    return figures


def joined(parts: Iterable[RunFigures]) -> RunFigures:
    """Join the figures of spans in order of time. A stop at the end of one continues at the beginning of the
    next one with readings."""
    whole = RunFigures()
    for part in parts:
        whole.by_minute |= part.by_minute
        if not part.known:
            continue
        moved = part.stops[0].at - whole.stops[-1].until if part.stops and whole.stops else MOMENT
        goes_on = moved < MOMENT or (whole.ended_stopped and part.began_stopped)
        if goes_on:
            whole.stops[-1].until = part.stops[0].until
        whole.known += part.known
        whole.running += part.running
        whole.at_speed += part.at_speed
        whole.travel += part.travel
        whole.fastest = max(whole.fastest, part.fastest)
        whole.stops += part.stops[goes_on:]
        whole.ended_stopped = part.ended_stopped
    return whole


def runs_of_minutes(minutes: Iterable[Rollup]) -> list[Run]:
    """Return a run of averages for each minute. A unit that moved at all ran, and one that was at speed in
    every reading was at speed."""
    return [
        Run(
            at=each.start,
            until=each.start + MINUTE,
            readings=each.readings,
            commanded=-(-each.commanded_sum // each.readings),
            actual=-(-each.actual_sum // each.readings),
            analog=0,
            word=each.word_and,
        )
        for each in minutes
    ]


def stretches(
    table: Sequence[Sequence[int]], span: tuple[int, int], marks: Marks, usual: int, cuts: Sequence[int] = ()
) -> list[RunStretch]:
    """Return the stretches of a unit within a span, µs, from the columns of its runs (:class:`Run`), each of
    which counts up to the next one or to the hole after it. Runs outside of the span show how long those at
    its ends count. Neighbors are one stretch while the unit goes on standing, running or being at speed,
    unless the end of a minute or one of ``cuts`` is between them."""
    at, until, _, commanded, actual, _, words = table
    ends = _ends(at, until, marks, usual)
    within = slice(bisect_right(ends, span[0]), bisect_left(at, span[1]))
    at, ends, commanded, actual, words = (list(each[within]) for each in (at, ends, commanded, actual, words))
    if not at:
        return []
    at[0], ends[-1] = max(at[0], span[0]), min(ends[-1], span[1])
    kinds = [
        raw and (1 if raw > 0 else -1) * (2 if setpoint > 0 and word & _AT_SPEED else 1)
        for raw, setpoint, word in zip(actual, commanded, words, strict=True)
    ]
    edges = {0, len(at), *(bisect_left(at, cut) for cut in cuts)}
    edges.update(bisect_left(at, minute) for minute in range(at[0] - at[0] % MINUTE, ends[-1], MINUTE))
    for changed in (map(ne, kinds[1:], kinds), map(ne, at[1:], ends)):
        edges.update(compress(count(1), changed))
    weighted = list(map(mul, actual, map(sub, ends, at)))
    found = []
    for i, j in pairwise(sorted(edges)):
        begin, end = at[i], ends[j - 1]
        if end > begin:
            average = sum(weighted[i:j]) / (end - begin)
            found.append(RunStretch(begin, end, commanded[i], average, max(actual[i:j]), words[i]))
    return found


def _ends(at: Sequence[int], until: Sequence[int], marks: Marks, usual: int) -> list[int]:
    """Return until when each run counts, µs: up to the next run, or to the hole after it."""
    edges = list(chain.from_iterable(zip(at, until, strict=True)))
    ends = [*at[1:], *until[-1:]]
    for position in holes(edges, marks, usual):
        if position % 2:
            ends[position // 2] = edges[position]
    return ends


def minute_figures(runs: Sequence[Run], marks: Marks, scales: Scaling) -> dict[int, RunFigures]:
    """Return the figures of each minute by its beginning, µs, without stops and the greatest speed. A run
    over the end of a minute is divided."""
    lasting: defaultdict[tuple[int, int, int, bool], int] = defaultdict(int)
    since = scales.since
    ends = _ends([run.at for run in runs], [run.until for run in runs], marks, usual_interval(runs))
    for run, until in zip(runs, ends, strict=True):
        at, actual, is_at_speed = run.at, run.actual, _is_at_speed(run)
        place = bisect_right(since, at)
        while until > (end := at - at % MINUTE + MINUTE):
            lasting[end, place, actual, is_at_speed] += end - at
            at = end
        lasting[end, place, actual, is_at_speed] += until - at
    found: dict[int, RunFigures] = {}
    for (end, place, raw, is_at_speed), each in lasting.items():
        figures = found.setdefault(end - MINUTE, RunFigures())
        figures.known += each
        if raw:
            figures.running += each
            figures.travel += scales.scales[max(0, place - 1)].apply(raw) * each
            figures.at_speed += each if is_at_speed else 0
    return found


def _cause(run: RunStretch, estop_healthy: int) -> StopCause:
    bits = status_bits(run.word >> 8, run.word & 255, estop_healthy)
    if bits.estop_active:
        return "estop"
    if not bits.run:
        return "run_off"
    return "speed_zero" if run.commanded == 0 else "unknown"


STORED_DECIMALS = 2


class SpeedStretch(NamedTuple):
    """A speed from one time until another, µs."""

    at: int
    until: int
    speed: float


class DrawFigures(NamedTuple):
    """The draw in percent: of all web that passed, and of the minutes with the least and the greatest
    draw."""

    average: float
    least: float
    greatest: float


class PassedWeb(NamedTuple):
    """The web that passed two sections while both ran: speed times µs of the one ``before`` and of the
    ``section``, and the draw of the minutes with the least and the greatest draw."""

    before: float
    section: float
    least: float
    greatest: float


def passed_web(before: Sequence[SpeedStretch], section: Sequence[SpeedStretch]) -> PassedWeb | None:
    """Return the web that passed a section and the one before while both ran; None if they never ran at the
    same time. Both are in order of time."""
    minutes: dict[int, tuple[float, float]] = {}
    for at, until, speed_before, speed in _together(before, section):
        passed, went = minutes.get(at // MINUTE, (0.0, 0.0))
        lasting = until - at
        minutes[at // MINUTE] = passed + speed_before * lasting, went + speed * lasting
    if not minutes:
        return None
    draws = [draw_percent(*lengths) or 0.0 for lengths in minutes.values()]
    passed, went = (sum(lengths) for lengths in zip(*minutes.values(), strict=True))
    return PassedWeb(passed, went, min(draws), max(draws))


def draw_figures(parts: Iterable[PassedWeb | None]) -> DrawFigures | None:
    """Return the draw over spans, none of which divides a minute; None if nothing passed."""
    read = [part for part in parts if part is not None]
    if not read:
        return None
    before, section, least, greatest = zip(*read, strict=True)
    return DrawFigures(draw_percent(sum(before), sum(section)) or 0.0, min(least), max(greatest))


def _together(
    before: Sequence[SpeedStretch], section: Sequence[SpeedStretch]
) -> Iterator[tuple[int, int, float, float]]:
    """Yield the pieces of time that both cover, with both speeds."""
    i = j = 0
    while i < len(before) and j < len(section):
        one, other = before[i], section[j]
        if one[:2] == other[:2]:  # as is usual: complete minutes
            yield one.at, one.until, one.speed, other.speed
            i, j = i + 1, j + 1
            continue
        at, until = max(one.at, other.at), min(one.until, other.until)
        if until > at:
            yield at, until, one.speed, other.speed
        if one.until <= other.until:
            i += 1
        else:
            j += 1


def draw_series(before: Series, section: Series, width: int) -> Series:
    """Return the draw in percent at each time at which either speed has a point; None while either stands or
    has a hole. ``width``: the length of the stretch of a point, µs, 0 for single readings. The draw of a
    stretch is that of its averages, and so of the web that passed; its least and greatest are equal."""
    at = sorted({*before.at, *section.at})
    speed_before, speed = _held(before, width), _held(section, width)
    draws = [draw_percent(speed_before(time), speed(time)) for time in at]
    return Series(at, draws, list(draws), list(draws))


def _held(series: Series, width: int) -> Callable[[int], float | None]:
    """Return a function that returns the speed at a time: that of the last point, which holds until the next
    one or, after the last point, as long as a hole may be."""
    times, speeds = series.at, series.average

    def at(time: int) -> float | None:
        place = bisect_right(times, time) - 1
        is_over = place == len(times) - 1 and time - times[-1] > width + LONG_GAP
        return None if place < 0 or is_over else speeds[place]

    return at


def draw_percent(before: float | None, section: float | None) -> float | None:
    """Return the draw of two speeds in percent; None while either stands or is not known."""
    return round(100 * (section / before - 1), STORED_DECIMALS) if before and section else None
