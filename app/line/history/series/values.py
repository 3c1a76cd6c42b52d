"""The meaning of stored numbers: the values of a unit, their scales, holes between readings, bits. Pure."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, compress, count, pairwise
from operator import itemgetter, ne, sub
from typing import Literal, NamedTuple

from app.line.history.series.runs import MINUTE, SECOND, PlainRun, Run
from bus.catalogue.parameters import ANALOG_IN_HIGH, ANALOG_IN_LOW, DECIMALS, FOLLOWER_MODE
from bus.catalogue.values import RATIO_DECIMALS
from bus.settings import BusSettings, UnitSettings

ValueKind = Literal["speed", "analog", "draw", "bit"]

_INPUTS = {
    "run": "run",
    "estop": "emergency stop",
    "preset": "preset",
    "reverse": "reverse",
    "up": "up",
    "down": "down",
    "slave": "follower",
}
"""The bits of ST1, bit 0 first (manual, READ SPEED AND STATUS)."""
_OUTPUTS = {f"output.{n}": "output {n}" for n in range(1, 7)} | {"remote": "remote", "at_speed": "at speed"}
"""The bits of ST2, bit 0 first."""


@dataclass(frozen=True, slots=True)
class Value:
    """A value of a unit. ``words``: its English name, in which ``{n}`` is the number of an output; ``bit``:
    its place in ST2 * 256 + ST1, -1 for a number. A draw is not stored, but made of its ``column`` of the
    unit before and of the unit itself."""

    name: str
    kind: ValueKind
    column: Literal["commanded", "actual", "analog", "word"]
    bit: int = -1
    words: str = ""


VALUES: dict[str, Value] = {
    value.name: value
    for value in (
        Value("commanded", "speed", "commanded", words="commanded"),
        Value("actual", "speed", "actual", words="actual"),
        Value("analog", "analog", "analog", words="analog input"),
        Value("draw", "draw", "actual", words="draw"),
        *(Value(name, "bit", "word", bit, words) for bit, (name, words) in enumerate(_INPUTS.items())),
        *(Value(name, "bit", "word", 8 + bit, words) for bit, (name, words) in enumerate(_OUTPUTS.items())),
    )
}
"""The values by name, as ``GET /api/v1/history`` takes them."""


def unit_settings(bus: BusSettings, number: int) -> UnitSettings:
    return next(unit for unit in bus.unit if unit.id == number)


def text(value: Value, translate: Callable[..., str]) -> str:
    """Return the name of a value in the language of ``translate``, which takes English words and
    parameters."""
    return translate(value.words, n=value.name.removeprefix("output."))


def label(unit: UnitSettings, value: Value) -> str:
    """Return the label of the wiring of a value; empty if there is none."""
    if value.kind == "analog":
        return unit.labels.analog
    if value.name.startswith("output."):
        return unit.labels.output.get(int(value.name.removeprefix("output.")), "")
    return {str(name): text for name, text in unit.labels.input.items()}.get(value.name, "")


def measure(unit: UnitSettings, value: Value) -> str:
    """Return the unit of measure of a value; empty if none is configured."""
    return {"speed": unit.labels.unit, "analog": unit.labels.analog_unit, "draw": "%", "bit": ""}[value.kind]


DECIDING = (DECIMALS, FOLLOWER_MODE, ANALOG_IN_LOW, ANALOG_IN_HIGH)
_MASTER = 0
_MAX_DECIMALS = 4
_ANALOG_FULL = 255


class ParameterStep(NamedTuple):
    """The raw value of a parameter from ``at`` on (µs)."""

    at: int
    number: int
    raw: int


@dataclass(frozen=True, slots=True)
class LinearScale:
    """The scale value = offset + raw * rise / per. ``decimals`` is None if not known or not fixed."""

    offset: int = 0
    rise: int = 1
    per: int = 1
    decimals: int | None = None

    def apply(self, raw: float) -> float:
        """Convert a raw value, or an average of raw values, to display units."""
        return self.offset + raw * self.rise / self.per

    def apply_all(self, raws: Iterable[float]) -> list[float]:
        offset, rise, per = self.offset, self.rise, self.per
        return [offset + raw * rise / per for raw in raws]

    @property
    def falling(self) -> bool:
        """Whether the greatest raw value is the least value."""
        return self.rise < 0


@dataclass(frozen=True, slots=True)
class Scaling:
    """Scales in order of time, of which the first also holds before its time."""

    since: Sequence[int]
    scales: Sequence[LinearScale]

    def at(self, time: int) -> LinearScale:
        """Return the scale in force at a time, µs."""
        return self.scales[max(0, bisect_right(self.since, time) - 1)]

    def stretches(self, times: Sequence[int]) -> Iterator[tuple[int, int, LinearScale]]:
        """Split times, which are in order, into ranges of positions, each with the scale in force."""
        i = 0
        while i < len(times):
            place = max(1, bisect_right(self.since, times[i]))
            j = bisect_left(times, self.since[place], i) if place < len(self.since) else len(times)
            yield i, j, self.scales[place - 1]
            i = j


def scaling(value: Value, steps: Sequence[ParameterStep], bus: BusSettings) -> Scaling:
    """Return the scales of a value over all time. CS and AS of a follower may be ratios, by the dialect of
    the bus."""
    ratio = bus.follower_speed == "ratio"
    if value.kind == "bit":
        inverted = value.name == "estop" and bus.estop_healthy == 1
        return Scaling([0], [LinearScale(1, -1, 1, 0) if inverted else LinearScale(decimals=0)])
    known: dict[int, int] = {}
    for step in sorted(steps, reverse=True):
        known[step.number] = step.raw
    since, scales = [0], [_scale(value, known, ratio)]
    for step in sorted(steps):
        known[step.number] = step.raw
        since.append(step.at)
        scales.append(_scale(value, known, ratio))
    return Scaling(since, scales)


def _scale(value: Value, known: dict[int, int], ratio: bool) -> LinearScale:
    if value.kind == "analog":
        low, high = known.get(ANALOG_IN_LOW), known.get(ANALOG_IN_HIGH)
        if low is None or high is None:
            return LinearScale()
        return LinearScale(low, high - low, _ANALOG_FULL)
    decimals = known.get(DECIMALS)
    if ratio and known.get(FOLLOWER_MODE, _MASTER) != _MASTER:
        decimals = RATIO_DECIMALS
    if decimals is None or decimals > _MAX_DECIMALS:
        return LinearScale()
    return LinearScale(per=10**decimals, decimals=decimals)


def was_follower(steps: Iterable[ParameterStep], end: int) -> bool:
    """Return whether a unit followed a master just before a time, µs."""
    modes = [step for step in sorted(steps) if step.number == FOLLOWER_MODE and step.at < end]
    return bool(modes and modes[-1].raw)


LONG_GAP = 10 * SECOND
MANY_INTERVALS = 10
"""A gap longer than both is a hole in any case."""
SHORT_GAP = 3 * SECOND // 10
FEW_INTERVALS = 3
"""A gap longer than both is a hole if the unit or port was found again at its end."""
_SAMPLE = 2000


@dataclass(frozen=True, slots=True)
class Marks:
    """The times at which a unit or its port was lost and found, µs, in order."""

    lost: Sequence[int] = ()
    found: Sequence[int] = ()


def usual_interval(runs: Sequence[Sequence[int]]) -> int:
    """Return the usual interval between responses, µs, from runs (``at``, ``until``, ``readings``, … each), 0
    if they are too few. Readings within a run count too: a steady value has only holes between its runs."""
    sample = runs[:_SAMPLE]
    if not sample:
        return 0
    at, until, readings, *_ = zip(*sample, strict=True)
    lengths = sorted(map(sub, at[1:], until))
    if readings.count(1) == len(readings):
        return lengths[(len(lengths) - 1) // 2] if lengths else 0
    spans = [(length, 1) for length in lengths]
    spans += [((run[1] - run[0]) // (run[2] - 1), run[2] - 1) for run in sample if run[2] > 1]
    return _middle(sorted(spans))


def _middle(spans: Iterable[tuple[int, int]]) -> int:
    """Return the median of lengths in order, each with its number."""
    spans = list(spans)
    left = sum(often for _, often in spans) / 2
    for length, often in spans:
        left -= often
        if left <= 0:
            return length
    return 0


def short_gap(usual: int) -> int:
    """Return the longest gap, µs, that is no hole unless a loss was reported. ``usual``: the usual interval,
    µs."""
    return max(SHORT_GAP, FEW_INTERVALS * usual)


def long_gap(usual: int) -> int:
    """Return the longest gap, µs, that may be no hole. ``usual``: the usual interval, µs."""
    return max(LONG_GAP, MANY_INTERVALS * usual)


def holes(times: Sequence[int], marks: Marks, usual: int, width: int = 0) -> list[int]:
    """Return the positions ``i`` with a hole between ``times[i]`` and ``times[i + 1]``, in order. ``width``:
    a time stands for all readings within so many µs after it."""
    differences = list(map(sub, times[1:], times))
    short = width + short_gap(usual)
    if not marks.lost and max(differences, default=0) <= short:
        return []
    limit = width + long_gap(usual)
    found = {i for i, difference in enumerate(differences) if difference > limit}
    lost = {bisect_left(times, mark) - 1 for mark in marks.lost}
    found |= {i for i in lost if 0 <= i < len(differences) and differences[i] > width}
    # A gap ends at the reading just before the mark, at that of the mark, or at the next.
    last = [(mark, bisect_right(times, mark) - 1) for mark in marks.found]
    ended = {i - 1 if i >= 0 and mark - times[i] <= usual else i for mark, i in last}
    found |= {i for i in ended if 0 <= i < len(differences) and differences[i] > short}
    return sorted(found)


_PART = itemgetter(*(Run._fields.index(name) for name in ("at", "until", "word")))
"""A function that returns the fields of a run that make an interval."""


class Interval(NamedTuple):
    """The bits of a unit (ST2 * 256 + ST1), which stayed the same from ``at`` until ``until`` (µs)."""

    at: int
    until: int
    word: int


def united(spans: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return spans of time, in order, in which those that touch are joined."""
    found: list[tuple[int, int]] = []
    for at, until in sorted(spans):
        if found and at <= found[-1][1]:
            found[-1] = (found[-1][0], max(until, found[-1][1]))
        else:
            found.append((at, until))
    return found


def intervals(parts: Iterable[tuple[int, int, int]], marks: Marks, usual: int = 0) -> list[Interval]:
    """Join neighbors with the same bits and no hole between them; return the intervals in order of time."""
    ordered = sorted(parts)
    if not ordered:
        return []
    starts, ends, words = zip(*ordered, strict=True)
    changed = compress(count(1), map(ne, words[1:], words))
    cuts = sorted({0, len(ordered), *_broken(starts, list(accumulate(ends, max)), marks, usual), *changed})
    return [Interval(starts[i], max(ends[i:j]), words[i]) for i, j in pairwise(cuts)]


def _broken(starts: Sequence[int], reach: Sequence[int], marks: Marks, usual: int) -> set[int]:
    """Return the positions of parts after a hole. ``reach``: the latest end of all parts up to each."""
    # Usually there is none, and each minute of each unit passes here.
    if not marks.lost and max(map(sub, starts[1:], reach), default=0) <= short_gap(usual):
        return set()
    begins = map(max, starts, (0, *reach))
    edges = [time for pair in zip(begins, reach, strict=True) for time in pair]
    return {i // 2 + 1 for i in holes(edges, marks, usual) if i % 2}


def splice(stored: Sequence[Interval], minute: int, runs: Sequence[PlainRun], marks: Marks) -> list[Interval]:
    """Return the intervals that replace ``stored``, which touch a minute or are next to it, once all runs of
    the minute are known."""
    after = minute + MINUTE
    around = [part._replace(until=min(part.until, minute - 1)) for part in stored if part.at < minute]
    around += [part._replace(at=max(part.at, after)) for part in stored if part.until >= after]
    return intervals([*around, *map(_PART, runs)], marks, usual_interval(runs))
