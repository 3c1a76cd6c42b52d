"""The tables of the plant's database, and their rows: plain values in engineering units. Pure."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from operator import itemgetter
from typing import Any, NamedTuple

from app.line.history.series.figures import RunFigures, Series
from app.line.history.series.runs import SECOND, Run
from app.line.history.series.values import VALUES, Scaling
from app.people.audit.entry import is_moment
from app.records.handover.figures import length_measure
from bus.settings import BusSettings, UnitSettings

Row = tuple[Any, ...]
BITS = tuple(value for value in VALUES.values() if value.kind == "bit")
BIT_COLUMNS = tuple(value.name.replace(".", "_") for value in BITS)
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)


class Table(NamedTuple):
    """A table of the plant's database. ``columns``: in the order of a row, without the first column, which
    names the site; ``key``: the columns that identify a row of a site; ``is_final``: a row never changes."""

    name: str
    columns: tuple[str, ...]
    key: tuple[str, ...]
    is_final: bool = False


READING = Table(
    "reading",
    ("at", "bus", "unit", "commanded", "actual", "analog", "decimals", *BIT_COLUMNS, "link"),
    ("at", "bus", "unit"),
)
MINUTE_TABLE = Table(
    "minute",
    (
        *("at", "bus", "unit", "count", "actual_min", "actual_avg", "actual_max"),
        *("known_s", "run_s", "at_speed_s", "length"),
    ),
    ("at", "bus", "unit"),
)
EVENT = Table(
    "event",
    (
        *("at", "id", "kind", "about", "who", "origin", "bus", "unit", "what", "old", "new"),
        *("old_raw", "new_raw", "outcome", "message", "count", "previous", "hash"),
    ),
    ("at", "id", "hash"),
    is_final=True,
)
ALARM = Table(
    "alarm",
    (
        *("came", "alarm", "occurrence", "code", "name", "bus", "unit", "priority"),
        *("cleared", "acknowledged", "acknowledged_by", "comment"),
    ),
    ("came", "alarm", "occurrence"),
)
UNIT = Table(
    "unit",
    (
        *(
            "valid_from",
            "bus",
            "unit",
            "name",
            "section",
            "speed_unit",
            "length_unit",
            "analog_name",
            "analog_unit",
        ),
        *(f"output_{number}_name" for number in range(1, 7)),
    ),
    ("valid_from", "bus", "unit"),
)
TABLES = (READING, MINUTE_TABLE, EVENT, ALARM, UNIT)


@dataclass
class Batch:
    """The rows that are sent together, by table and key."""

    rows: dict[Table, dict[Row, Row]] = field(default_factory=dict)

    def add(self, table: Table, rows: Iterable[Row]) -> None:
        """Add rows of a table; a row replaces an earlier one with the same key."""
        key = itemgetter(*map(table.columns.index, table.key))
        self.rows.setdefault(table, {}).update((key(row), row) for row in rows)

    @property
    def size(self) -> int:
        """The number of rows."""
        return sum(map(len, self.rows.values()))


def instant(at: int) -> datetime:
    """Convert µs since the epoch to an instant, exactly."""
    return _EPOCH + at * _MICROSECOND


def instant_of(at: float | None) -> datetime | None:
    """Convert Unix time to an instant; a time outside the calendar becomes 1970."""
    return None if at is None else instant(round(at * SECOND) if is_moment(at) else 0)  # type: ignore[arg-type]


# --- readings ---


def points_of(runs: Iterable[Run]) -> Iterator[tuple[int, Run]]:
    """Yield the first reading of each run and, if the run lasted, its last one."""
    for run in runs:
        yield run.at, run
        if run.until > run.at:
            yield run.until, run


def steps_of(runs: Iterable[Run], step: int) -> Iterator[tuple[int, Run]]:
    """Yield the last reading of each step in which the unit responded, with the start of the step, µs."""
    last: dict[int, Run] = {}
    for run in runs:
        first = run.at - run.at % step
        if run.until < first + step:
            last[first] = run
        else:
            last.update(dict.fromkeys(_steps_within(run, step), run))
    yield from sorted(last.items())


def _steps_within(run: Run, step: int) -> Iterable[int]:
    first, final = run.at - run.at % step, run.until - run.until % step
    apart = (run.until - run.at) / max(1, run.readings - 1)
    if apart <= step:
        return range(first, final + step, step)
    instants = (run.at + round(number * apart) for number in range(run.readings))
    return (at - at % step for at in instants)


class Scales(NamedTuple):
    """The scales of the values of a unit over all time."""

    commanded: Scaling
    actual: Scaling
    analog: Scaling


def reading_rows(
    place: tuple[str, int], points: Iterable[tuple[int, Run]], scales: Scales, estop_healthy: int
) -> Iterator[Row]:
    """Yield the rows of a unit at points in order of time. ``place``: its bus and its number."""
    changes = sorted({at for scaling in scales for at in scaling.since})
    known: dict[Row, Row] = {}
    for at, run in points:
        sent = (bisect_right(changes, run.at), *run[3:])
        values = known.get(sent)
        if values is None:
            commanded, actual, analog = (scaling.at(run.at) for scaling in scales)
            values = known[sent] = (
                commanded.apply(run.commanded),
                actual.apply(run.actual),
                analog.apply(run.analog),
                actual.decimals,
                *_bits(run.word, estop_healthy),
                "online",
            )
        yield (instant(at), *place, *values)


@cache
def _bits(word: int, estop_healthy: int) -> tuple[bool, ...]:
    bits = {value.name: bool(word >> value.bit & 1) for value in BITS}
    return tuple((bits | {"estop": bits["estop"] != bool(estop_healthy)}).values())


def lost_row(place: tuple[str, int], at: int, link: str) -> Row:
    """Return the row, without values, of the moment at which a unit or its bus was lost."""
    values = (None,) * (len(READING.columns) - len(READING.key) - 1)
    return (instant(at), *place, *values, link)


# --- minutes ---


def minute_rows(
    place: tuple[str, int],
    series: Series,
    counts: Iterable[int],
    figures: Mapping[int, RunFigures] | None,
    per_s: int | None,
) -> Iterator[Row]:
    """Yield the rows of the minutes of a unit. ``series``: its actual speed; ``figures``: of each minute,
    None for a follower whose speeds are ratios; ``per_s``: see `length_measure`."""
    columns = (series.at, counts, series.least, series.average, series.greatest)
    for at, count, least, average, greatest in zip(*columns, strict=True):
        run = None if figures is None else figures.get(at, RunFigures())
        yield (
            instant(at),
            *place,
            count,
            least,
            average,
            greatest,
            *(_times(run, per_s) if run else (None,) * 4),
        )


def _times(run: RunFigures, per_s: int | None) -> Row:
    length = None if per_s is None else run.travel / SECOND / per_s
    return run.known / SECOND, run.running / SECOND, run.at_speed / SECOND, length


# --- events, alarms, units ---


def event_row(entry: Mapping[str, Any]) -> Row:
    """Return the row of an entry of the audit log."""
    return (instant_of(entry["time"]), *(_text(entry[name]) for name in EVENT.columns[1:]))


def alarm_row(transitions: Sequence[Mapping[str, Any]]) -> Row | None:
    """Return the row of an alarm's occurrence from its transitions in order; None if it never came."""
    last = {each["trigger"]: each for each in transitions}
    came, cleared, answer = last.get("rise"), last.get("clear"), last.get("acknowledge")
    if came is None:
        return None
    return (
        instant_of(came["at"]),
        *(_text(came[name]) for name in ALARM.columns[1:8]),
        instant_of(cleared["at"]) if cleared else None,
        *(
            (instant_of(answer["at"]), _text(answer["who"]), _text(answer["reason"]))
            if answer
            else (None,) * 3
        ),
    )


def unit_row(bus: BusSettings, unit: UnitSettings, valid_from: datetime) -> Row:
    """Return the row of a unit with its names from ``valid_from`` on."""
    length, labels = length_measure(unit), unit.labels
    return (
        valid_from,
        bus.name,
        unit.id,
        unit.name,
        unit.group,
        labels.unit,
        length[0] if length else "",
        labels.analog,
        labels.analog_unit,
        *(labels.output.get(number, "") for number in range(1, 7)),
    )


def _text(value: Any) -> Any:
    """Replace NUL, which PostgreSQL does not take."""
    return value.replace("\0", "\ufffd") if isinstance(value, str) else value
