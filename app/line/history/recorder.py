"""Writes updates to the disk: commits about twice a second, and folds complete minutes.

Everything here runs on the one thread that writes (:mod:`app.line.history.writer`).
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
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
    combine,
    merge_plain,
    micros,
    minute_rollups,
    plain_run,
    replace_rows,
    rollup,
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
from app.line.history.tail import Tail
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message, in_english

FoundDamage = Callable[[Message], None]
"""A function that is called on the writer's thread with the text of an event."""
_HELD: dict[StoredTier, Message] = {
    "raw": Message("history_readings"),
    "minutes": Message("history_minutes"),
    "hours": Message("history_hours"),
}


def set_aside(database: Database, block: BlockKey, on_damage: FoundDamage) -> None:
    """Move a block aside if it is damaged, and report it. Raises StoreError."""

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
        # Before its first value, that one counts.
        in_force = next((each for each in reversed(known) if each.at <= step.at), known[0] if known else None)
        if in_force is None or in_force.raw != step.raw:
            tables.write_parameter(connection, key, step)


GRACE = 2 * SECOND
"""The time after a minute, µs, in which its last readings are awaited."""


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
        """Write deliveries to the disk, then into the tail. Raises StoreError if nothing was stored."""

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
        """Fold all minutes, also the current one, until ``deadline`` (monotonic seconds); the journal holds
        the rest."""
        self._folding = deque(self._tail.over(current=-1))
        while self._folding and monotonic_now() < deadline:
            self._fold_some(next_to_fold(self._folding, self._tail))

    def _fold_some(self, keys: Sequence[Minute]) -> None:
        done, is_last = set(keys), len(keys) == len(self._folding)

        def write(connection: tables.StoreConnection) -> None:
            fold_minutes(connection, self._tail, keys)
            if is_last:
                # The rest, which is in no block yet, is written again.
                tables.write_journal_again(connection, self._tail.everything(without=done))

        try:
            self._database.write_now(write)
        except DamagedBlock as found:
            # It costs itself: these minutes are folded in the next turn, without it.
            set_aside(self._database, found.block, self._on_damage)
            return
        for key in keys:
            self._tail.drop(*key)
            self._folding.popleft()


RawBlock = tuple[int, int, Sequence[PlainRun]]
"""The start and the span of a block in µs, and its runs."""


def raw_blocks(connection: StoreConnection, units: Iterable[int], minute: int) -> dict[int, RawBlock]:
    """Return the block of each unit that contains a minute, of those that have one. Raises DamagedBlock."""
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
"""Runs that one transaction folds, in about 50 ms, so that a slow machine still commits in time."""
MAX_KEYS = 64
"""Minutes of units that one transaction folds, each with a block and its bits."""
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
    """Fold minutes of the tail into their blocks, except those that are too old. Raises DamagedBlock."""
    given_up = tables.raw_from(connection)
    of_minute: dict[int, dict[int, list[PlainRun]]] = {}
    for unit, minute in keys:
        if minute + MINUTE > given_up and (runs := tail.minute(unit, minute)):
            of_minute.setdefault(minute, {})[unit] = runs
    for minute, by_unit in sorted(of_minute.items()):
        fold(connection, minute, by_unit)


def fold(connection: tables.StoreConnection, minute: int, by_unit: _Runs) -> None:
    """Fold one minute of some units into their blocks. Raises DamagedBlock."""
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
    """Pack the minutes of a unit and hour into one smaller block, with its rollups. Raises DamagedBlock."""
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
