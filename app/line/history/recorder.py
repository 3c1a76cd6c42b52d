"""The recorder, which writes updates to the disk: it commits about twice a second, and folds complete
minutes. Readings of minutes that are not over yet are in memory too, as their tail.

The recorder runs on the one thread that writes (:mod:`app.line.history.writer`), and alone adds to the tail
and drops from it; any thread reads the tail.
"""

from __future__ import annotations

import json
import math
import struct
import threading
from array import array
from bisect import bisect_right, insort
from collections import deque
from collections.abc import Callable, Collection, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from app.core.database import Database
from app.core.database.connection import upsert
from app.line.history import tables
from app.line.history.series.runs import (
    DAY,
    HOUR,
    MINUTE,
    SECOND,
    PlainRun,
    Rollup,
    Run,
    combine,
    follows,
    joined,
    merge_plain,
    micros,
    minute_rollups,
    plain_run,
    replace_rows,
    rollup,
    runs_of,
)
from app.line.history.series.values import DECIDING, Interval, ParameterStep, splice
from app.line.history.tables import (
    INSERT_RAW,
    BlockKey,
    DamagedBlock,
    StoreConnection,
    StoredTier,
    block_runs,
    new_raw_ids,
    raw_row,
)
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message, in_english

WIDTH = len(Run._fields)
_BYTES = struct.Struct(f"{WIDTH}q").pack
"""Packs a run faster than `array.extend` takes a tuple."""
_UNTIL = Run._fields.index("until")
_ACTUAL = Run._fields.index("actual") - WIDTH
BREAK = 2 * SECOND
"""Equal readings further apart than this do not make one run: there may be a hole between."""


def _last(runs: array[int]) -> PlainRun:
    at, until, readings, commanded, actual, analog, word = runs[-WIDTH:]
    return at, until, readings, commanded, actual, analog, word


def _plain(runs: Iterable[int]) -> list[PlainRun]:
    return list(zip(*[iter(runs)] * WIDTH, strict=True))


def _by_time(key: tuple[int, int]) -> tuple[int, int]:
    return key[1], key[0]


class Tail:
    """Runs by unit and minute, in order of arrival. Their fields stand one after the other in an array,
    because the garbage collector would visit half a million tuples every few seconds."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._minutes: dict[tuple[int, int], array[int]] = {}
        self._lost: dict[int, list[int]] = {}
        """The times at which each unit stopped responding (µs), in order."""

    def add(self, rows: Iterable[tuple[int, PlainRun]]) -> None:
        """Add readings or runs of units, in order of arrival."""
        with self._lock:
            for unit, run in rows:
                self._add_one(unit, run)

    def _add_one(self, unit: int, run: PlainRun) -> None:
        key = unit, run[0] - run[0] % MINUTE
        runs = self._minutes.get(key)
        if runs is None:
            self._minutes[key] = array("q", run)
            return
        # The actual speed goes first, because it differs most often.
        if runs[_ACTUAL] == run[_ACTUAL]:
            last = _last(runs)
            if follows(run, last) and not self._broken(unit, last[1], run[0]):
                del runs[-WIDTH:]
                run = joined(last, run)
        runs.frombytes(_BYTES(*run))

    def _broken(self, unit: int, since: int, until: int) -> bool:
        if until - since > BREAK:
            return True
        lost = self._lost.get(unit, ())
        place = bisect_right(lost, since)
        return place < len(lost) and lost[place] <= until

    def mark_lost(self, lost: Iterable[tuple[int, int]]) -> None:
        """Note when units stopped responding (µs), which no run crosses. Call it before the readings that
        follow are added."""
        with self._lock:
            for unit, at in lost:
                insort(self._lost.setdefault(unit, []), at)

    def interrupt(self) -> None:
        """Let the next reading of every unit begin a new run, because nothing was recorded until now."""
        self.mark_lost({(unit, run[1] + 1) for unit, run in self.everything()})

    def runs(self, unit: int, start: int, end: int) -> list[Run]:
        """Return a unit's runs that touch a span (µs), in order of time."""
        with self._lock:
            found = [
                run
                for (owner, minute), runs in self._minutes.items()
                if owner == unit and minute < end and minute + MINUTE > start
                for run in _plain(runs)
            ]
        return runs_of(sorted(run for run in found if run[0] < end and run[1] >= start))

    def since(self, after: int) -> dict[int, list[PlainRun]]:
        """Return the last runs of each unit that reach a time, µs, in order of arrival, at the cost of these
        runs only."""
        found: dict[int, list[PlainRun]] = {}
        with self._lock:
            for (unit, minute), runs in self._minutes.items():
                place = len(runs) if minute + MINUTE > after else 0
                while place and runs[place - WIDTH + _UNTIL] >= after:
                    place -= WIDTH
                if place < len(runs) and minute + MINUTE > after:
                    found.setdefault(unit, []).extend(_plain(runs[place:]))
        return found

    def hours_near(self, units: Collection[int]) -> set[int]:
        """Return the hours, µs, whose figures readings of units will undo once they are in their blocks."""
        with self._lock:
            return {
                edge - edge % HOUR
                for unit, minute in self._minutes
                if unit in units
                for edge in (minute - 2 * MINUTE, minute + 3 * MINUTE - 1)
            }

    def minute(self, unit: int, minute: int) -> list[PlainRun]:
        """Return all runs of one unit in one minute."""
        with self._lock:
            return _plain(self._minutes.get((unit, minute), ()))

    def count(self, unit: int, minute: int) -> int:
        """Count the runs of one unit in one minute."""
        with self._lock:
            return len(self._minutes.get((unit, minute), ())) // WIDTH

    def over(self, current: int) -> list[tuple[int, int]]:
        """Return units and minutes except the current minute, which is still growing, the oldest first."""
        with self._lock:
            return sorted((key for key in self._minutes if key[1] != current), key=_by_time)

    def extent(self) -> tuple[int, int] | None:
        """Return the span of all minutes, µs; None if there are none."""
        with self._lock:
            minutes = [minute for _, minute in self._minutes]
        return (min(minutes), max(minutes) + MINUTE) if minutes else None

    def drop(self, unit: int, minute: int) -> None:
        """Forget the runs of a minute that is stored in a block."""
        with self._lock:
            self._minutes.pop((unit, minute), None)
            if unit in self._lost:
                self._lost[unit] = [at for at in self._lost[unit] if at >= minute]

    def clear(self) -> None:
        """Forget everything, before the journal is read again."""
        with self._lock:
            self._minutes.clear()
            self._lost.clear()

    def everything(self, without: Container[tuple[int, int]] = ()) -> list[tuple[int, PlainRun]]:
        """Return each run with its unit, except those of the units and minutes in ``without``."""
        with self._lock:
            minutes = sorted(key for key in self._minutes if key not in without)
            return [(key[0], run) for key in minutes for run in _plain(self._minutes[key])]


FoundDamage = Callable[[Message], None]
"""A function that is called on the writer's thread with the text of an event."""
_HELD: dict[StoredTier, Message] = {
    "raw": Message("history_readings"),
    "minutes": Message("history_minutes"),
    "hours": Message("history_hours"),
}


def set_aside(database: Database, block: BlockKey, on_damage: FoundDamage) -> None:
    """Move a block aside if it is damaged, and report it. Raise StoreError."""

    def move(connection: tables.StoreConnection) -> str | None:
        is_moved = tables.move_damaged(connection, block, micros(unix_now()))
        return tables.name_of(connection, block.unit) if is_moved else None

    unit = database.write_now(move)
    if unit is not None:
        since = datetime.fromtimestamp(block.start / SECOND, UTC).isoformat(timespec="minutes")
        what = _HELD[block.tier]
        on_damage(Message.of("event_history_block_lost", what=what, unit=unit, since=since))


MARK_EVERY = SECOND
"""The time between two marks of implausible readings of a unit, µs: one that turns around 0 may have several
a second."""
BUS = 0
"""The unit number under which a bus itself has a key."""
Delivery = tuple[str, Sequence[Update]]
"""A bus and the updates of its worker."""


@dataclass(slots=True)
class Accepted:
    """The readings and losses of one transaction, which go into the tail once they are on disk."""

    rows: list[tuple[int, PlainRun]] = field(default_factory=list)
    lost: list[tuple[int, int]] = field(default_factory=list)
    """The units that stopped responding, with the time, µs."""


class Intake:
    """The intake of deliveries, which writes changes of links and parameters, and knows the keys of units."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget the keys and links: after a rollback they may not be on disk."""
        self._keys: dict[str, dict[int, int]] = {}
        self._links: dict[int, tuple[int, str]] = {}
        self._implausible: dict[int, int] = {}

    def accept(self, connection: tables.StoreConnection, deliveries: Iterable[Delivery]) -> Accepted:
        """Write the links and parameters of deliveries; return their readings and losses."""
        accepted = Accepted()
        for bus, updates in deliveries:
            keys = self._keys.setdefault(bus, {})
            for update in updates:
                if type(update) is Reading:
                    key = keys.get(update.unit) or self.key(connection, bus, update.unit)
                    if update.implausible:
                        self._mark_implausible(connection, key, micros(update.at), accepted)
                    else:
                        accepted.rows.append((key, plain_run(update)))
                elif isinstance(update, UnitLink | BusLink):
                    self._write_link(connection, bus, update, accepted)
                elif isinstance(update, ParameterValue):
                    self._write_parameter(connection, bus, update)
        return accepted

    def key(self, connection: tables.StoreConnection, bus: str, number: int) -> int:
        """Return the key of a unit, or of a bus as number 0."""
        keys = self._keys.setdefault(bus, {})
        if number not in keys:
            keys[number] = tables.unit_id(connection, bus, number)
        return keys[number]

    def _write_link(
        self, connection: tables.StoreConnection, bus: str, update: UnitLink | BusLink, accepted: Accepted
    ) -> None:
        key = self.key(connection, bus, update.unit if isinstance(update, UnitLink) else BUS)
        at = micros(update.at)
        newest, state = self._links.get(key, (at, ""))
        if at >= newest:
            self._links[key] = (at, update.link)
            if state == update.link:
                return
        tables.write_link(connection, key, at, update.link, in_english(update.cause))
        if update.link in tables.LOST_STATES:
            units = tables.units_of(connection, bus) if isinstance(update, BusLink) else [key]
            accepted.lost += [(unit, at) for unit in units]

    def _mark_implausible(
        self, connection: tables.StoreConnection, key: int, at: int, accepted: Accepted
    ) -> None:
        """Mark a reading with a speed that the manual rules out, at most once in `MARK_EVERY`: without a mark
        a trend would join the readings on either side of it."""
        if abs(at - self._implausible.get(key, -MARK_EVERY)) >= MARK_EVERY:
            self._implausible[key] = at
            tables.write_link(connection, key, at, tables.IMPLAUSIBLE, "")
            accepted.lost.append((key, at))

    def _write_parameter(self, connection: tables.StoreConnection, bus: str, update: ParameterValue) -> None:
        if update.number not in DECIDING or update.raw is None:
            return
        key = self.key(connection, bus, update.unit)
        step = ParameterStep(micros(update.at), update.number, update.raw)
        known = [each for each in tables.parameter_steps(connection, key) if each.number == step.number]
        # Before its first value, that value counts.
        in_force = next((each for each in reversed(known) if each.at <= step.at), known[0] if known else None)
        if in_force is None or in_force.raw != step.raw:
            tables.write_parameter(connection, key, step)


GRACE = 2 * SECOND
"""The time after a minute, µs, for which its last readings are awaited."""


class Recorder:
    """The writer of deliveries into the journal and the tail, and of complete minutes into blocks."""

    def __init__(self, database: Database, tail: Tail, on_damage: FoundDamage) -> None:
        self._database = database
        self._on_damage = on_damage
        self._tail = tail
        self._intake = Intake()
        self._folding: deque[Minute] = deque()
        self._folded_minute = 0

    def replay(self) -> None:
        """Load the journal into the tail without its damaged rows, which are reported."""
        self._tail.clear()
        read = self._database.read_now(lambda c: list(tables.read_journal(c)))
        journal = [rows for rows in read if rows is not None]
        if len(journal) < len(read):
            self._on_damage(Message("event_history_tail_damaged"))
        oldest = min((run.at for rows in journal for _, run in rows), default=0)
        if journal:
            self._tail.mark_lost(self._database.read_now(lambda c: tables.marks_since(c, oldest)))
        for rows in journal:
            self._tail.add(rows)
        self._tail.interrupt()

    def commit(self, deliveries: Sequence[Delivery]) -> None:
        """Write deliveries to the disk, then into the tail. Raise StoreError if nothing was stored."""

        def write(connection: tables.StoreConnection) -> Accepted:
            accepted = self._intake.accept(connection, deliveries)
            if accepted.rows:
                tables.write_journal(connection, accepted.rows)
            return accepted

        try:
            accepted = self._database.write_now(write)
        except BaseException:
            self._intake.forget()
            raise
        self._tail.mark_lost(accepted.lost)
        self._tail.add(accepted.rows)

    def fold(self, now: int, deadline: Monotonic) -> None:
        """Fold minutes that are over at ``now`` (µs) until ``deadline`` (monotonic seconds)."""
        minute = now - now % MINUTE
        if not self._folding and minute != self._folded_minute and now >= minute + GRACE:
            self._folded_minute = minute
            self._folding.extend(self._tail.over(minute))
        while self._folding and monotonic_now() < deadline:
            self._fold_some(next_to_fold(self._folding, self._tail))

    def fold_everything(self, deadline: Monotonic = Monotonic(math.inf)) -> None:
        """Fold all minutes, even the current one, until ``deadline`` (monotonic seconds); the journal holds
        the rest."""
        self._folding = deque(self._tail.over(current=-1))
        while self._folding and monotonic_now() < deadline:
            self._fold_some(next_to_fold(self._folding, self._tail))

    def _fold_some(self, keys: Sequence[Minute]) -> None:
        done, is_last = set(keys), len(keys) == len(self._folding)

        def write(connection: tables.StoreConnection) -> None:
            fold_minutes(connection, self._tail, keys)
            if is_last:
                # The remaining readings, which are in no block yet, are written again.
                tables.write_journal_again(connection, self._tail.everything(without=done))

        try:
            self._database.write_now(write)
        except DamagedBlock as found:
            # The fault is its own: these minutes are folded in the next turn, without it.
            set_aside(self._database, found.block, self._on_damage)
            return
        for key in keys:
            self._tail.drop(*key)
            self._folding.popleft()


RawBlock = tuple[int, int, Sequence[PlainRun]]
"""The start and the span of a block in µs, and its runs."""


def raw_blocks(connection: StoreConnection, units: Iterable[int], minute: int) -> dict[int, RawBlock]:
    """Return the block of each unit that contains a minute, of those that have one. Raise DamagedBlock."""
    rows = connection.execute(
        "SELECT unit, start, span, data FROM raw"
        " WHERE unit IN (SELECT value FROM json_each(?)) AND start IN (?, ?) ORDER BY start",
        (json.dumps([*units]), minute - minute % HOUR, minute),
    )
    return {
        unit: (start, span, block_runs(unit, start, data))
        for unit, start, span, data in rows
        if start + span > minute
    }


def write_raw_blocks(
    connection: StoreConnection, blocks: Mapping[int, RawBlock], before: Mapping[int, RawBlock]
) -> None:
    """Write blocks by unit in place of the blocks ``before``."""
    replaced = [(unit, block[0], block[1]) for unit, block in before.items()]
    if replaced:
        connection.executemany("DELETE FROM raw WHERE unit = ? AND start = ? AND span = ?", replaced)
    ids = new_raw_ids(connection, len(blocks))
    rows = [
        (*raw_row(unit, start, span, list(zip(*runs, strict=True))), number)
        for number, (unit, (start, span, runs)) in zip(ids, blocks.items(), strict=True)
    ]
    connection.executemany(INSERT_RAW, rows)


def replace_bits(
    connection: StoreConnection,
    old: Mapping[int, Sequence[Interval]],
    new: Mapping[int, Sequence[Interval]],
) -> None:
    """Replace intervals by unit; equal ones are not written again."""
    gone = [(unit, part.at, part.word) for unit, part in _missing(old, new)]
    if gone:
        connection.executemany("DELETE FROM bits WHERE unit = ? AND at = ? AND word = ?", gone)
    added = [(unit, part.at, part.word, part.until) for unit, part in _missing(new, old)]
    connection.executemany(upsert("bits", ("unit", "at", "word"), ("until",)), added)


def _missing(
    parts: Mapping[int, Sequence[Interval]], there: Mapping[int, Sequence[Interval]]
) -> Iterable[tuple[int, Interval]]:
    return ((unit, part) for unit, each in parts.items() for part in sorted(set(each) - set(there[unit])))


MAX_AT_ONCE = 10_000
"""The most runs that one transaction folds, in about 50 ms, so that a slow machine still commits in time."""
MAX_KEYS = 64
"""The most minutes of units that one transaction folds, each with a block and its bits."""
Minute = tuple[int, int]
"""The key of a unit and when the minute begins, µs."""
_Runs = Mapping[int, Sequence[PlainRun]]


def next_to_fold(folding: Iterable[Minute], tail: Tail) -> list[Minute]:
    """Return the first minutes, as many as one transaction folds."""
    keys: list[Minute] = []
    runs = 0
    for key in folding:
        keys.append(key)
        runs += tail.count(*key)
        if runs >= MAX_AT_ONCE or len(keys) == MAX_KEYS:
            break
    return keys


def fold_minutes(connection: tables.StoreConnection, tail: Tail, keys: Sequence[Minute]) -> None:
    """Fold minutes of the tail into their blocks, except those that are too old. Raise DamagedBlock."""
    given_up = tables.raw_from(connection)
    of_minute: dict[int, dict[int, list[PlainRun]]] = {}
    for unit, minute in keys:
        if minute + MINUTE > given_up and (runs := tail.minute(unit, minute)):
            of_minute.setdefault(minute, {})[unit] = runs
    for minute, by_unit in sorted(of_minute.items()):
        fold(connection, minute, by_unit)


def fold(connection: tables.StoreConnection, minute: int, by_unit: _Runs) -> None:
    """Fold one minute of some units into their blocks. Raise DamagedBlock."""
    before = raw_blocks(connection, by_unit, minute)
    blocks: dict[int, RawBlock] = {}
    for unit, runs in by_unit.items():
        start, span, known = before.get(unit, (minute, MINUTE, ()))
        blocks[unit] = start, span, merge_plain(known, runs)
    write_raw_blocks(connection, blocks, before)
    complete = {
        unit: [run for run in runs if minute <= run[0] < minute + MINUTE]
        for unit, (_, _, runs) in blocks.items()
    }
    for unit, runs in complete.items():
        if blocks[unit][1] == HOUR:
            _roll_up(connection, unit, blocks[unit][0], [rollup(runs, minute)])
    _bits(connection, minute, complete)


def compact(connection: tables.StoreConnection, unit: int, hour: int) -> None:
    """Pack the minutes of a unit and hour into one smaller block, with its rollups. Raise DamagedBlock."""
    stored = tables.raw_columns(connection, unit, hour, hour + HOUR)
    table = list(zip(*merge_plain((), zip(*stored, strict=True)), strict=True))
    if table:
        tables.write_raw(connection, unit, hour, HOUR, table)
        _roll_up(connection, unit, hour, minute_rollups(table))


def _roll_up(connection: tables.StoreConnection, unit: int, hour: int, rows: Sequence[Rollup]) -> None:
    """Write minutes of an hour in place of the stored ones, and the hour into its day."""
    day = hour - hour % DAY
    of_hour = replace_rows(tables.rollups_of(connection, "minutes", unit, hour), rows)
    of_day = replace_rows(tables.rollups_of(connection, "hours", unit, day), [combine(of_hour, hour)])
    tables.write_rollups(connection, "minutes", unit, hour, of_hour)
    tables.write_rollups(connection, "hours", unit, day, of_day)


def _bits(connection: tables.StoreConnection, minute: int, by_unit: _Runs) -> None:
    end = minute + MINUTE
    stored = tables.bits_around(connection, by_unit, minute, end)
    spans = {
        unit: (each[0].at, max(each[-1].until, end)) if each else (minute, end)
        for unit, each in stored.items()
    }
    marks = tables.link_marks(connection, spans)
    spliced = {unit: splice(stored[unit], minute, runs, marks[unit]) for unit, runs in by_unit.items()}
    replace_bits(connection, stored, spliced)
