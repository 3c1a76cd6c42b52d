"""Writes updates to the disk: commits about twice a second, and packs complete minutes and hours into blocks.

Everything here runs on the one thread that writes (:mod:`app.history.intake.writer`). A minute that comes
late takes the same way: its runs are merged with the stored ones, and the minute, its hour and its bits are
computed again from all of them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from app.database import Database
from app.history.intake.tail import Tail
from app.history.intake.updates import Delivery, Intake
from app.history.series.intervals import splice
from app.history.series.rollup import combine, replace_row, rollup
from app.history.series.runs import DAY, HOUR, MINUTE, SECOND, Run, merge
from app.history.store import tables
from app.history.store.damage import DamagedBlock
from app.history.store.inspection import FoundDamage, set_aside
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message

GRACE = 2 * SECOND
"""How long after a minute its last readings are waited for."""
MAX_IN_TAIL = 400_000
"""Runs in memory at which even the current minute is folded."""
MAX_AT_ONCE = 4_000
"""Runs folded in one transaction: few enough that a slow machine still commits in time."""
MAX_KEYS = 64
"""Minutes of units folded in one transaction: each is a block, its rollups and its bits."""
_LOOK_EVERY = 64


class Recorder:
    """Writes deliveries into the journal and the tail, and completed minutes and hours into blocks."""

    def __init__(self, database: Database, tail: Tail, on_damage: FoundDamage) -> None:
        self._database = database
        self._on_damage = on_damage
        self._tail = tail
        self._intake = Intake()
        self._folding: deque[tuple[int, int]] = deque()
        self._folded_minute = 0
        self._commits = 0

    def replay(self) -> None:
        """Load the journal into the tail; damaged parts are left out and reported."""
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
        """Write deliveries to the disk, then to the tail. Raises StoreError; then nothing is stored."""
        try:
            taken = self._database.write_now(lambda connection: self._intake.write(connection, deliveries))
        except BaseException:
            self._intake.forget()
            raise
        self._tail.mark_lost(taken.lost)
        self._tail.add(taken.rows)

    def fold(self, now: int, deadline: Monotonic) -> None:
        """Fold minutes and hours complete at ``now`` (µs) until ``deadline`` (monotonic seconds)."""
        if not self._folding and self._is_due(now):
            self._folded_minute = now - now % MINUTE
            self._folding.extend(self._tail.over(self._folded_minute))
        while self._folding and monotonic_now() < deadline:
            self._fold_some(self._next_to_fold())

    def fold_everything(self, deadline: Monotonic = Monotonic(math.inf)) -> None:
        """The current minute too, until ``deadline`` (monotonic seconds); the journal holds the rest."""
        self._folding = deque(self._tail.over(current=-1))
        while self._folding and monotonic_now() < deadline:
            self._fold_some(self._next_to_fold())

    def _next_to_fold(self) -> list[tuple[int, int]]:
        keys: list[tuple[int, int]] = []
        runs = 0
        for key in self._folding:
            keys.append(key)
            runs += len(self._tail.minute(*key))
            if runs >= MAX_AT_ONCE or len(keys) == MAX_KEYS:
                break
        return keys

    def _is_due(self, now: int) -> bool:
        minute = now - now % MINUTE
        self._commits += 1
        if self._commits % _LOOK_EVERY == 0 and len(self._tail) > MAX_IN_TAIL:
            self._folding.extend(self._tail.over(current=-1))
        return minute != self._folded_minute and now >= minute + GRACE

    def _fold_some(self, keys: Sequence[tuple[int, int]]) -> None:
        done, is_last = set(keys), len(keys) == len(self._folding)

        def write(connection: tables.StoreConnection) -> None:
            given_up = tables.raw_from(connection)
            for unit, minute in keys:
                runs = self._tail.minute(unit, minute)
                if runs and minute + MINUTE > given_up:
                    fold(connection, unit, minute, runs)
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


def fold(connection: tables.StoreConnection, unit: int, minute: int, runs: list[Run]) -> None:
    """One minute of one unit into its block, its rollups and its bits."""
    block = tables.raw_block(connection, unit, minute)
    start, span, known = block or (minute, MINUTE, [])
    everything = merge(known, runs)
    tables.write_raw(connection, unit, start, span, everything)
    of_minute = [run for run in everything if minute <= run.at < minute + MINUTE]
    _roll_up(connection, unit, minute, of_minute)
    _bits(connection, unit, minute, of_minute)


def compact(connection: tables.StoreConnection, unit: int, hour: int) -> None:
    """The minutes of one unit and hour as one block: fewer rows, and better packed."""
    runs = merge((), tables.raw_between(connection, unit, hour, hour + HOUR))
    if runs:
        tables.write_raw(connection, unit, hour, HOUR, runs)


def _roll_up(connection: tables.StoreConnection, unit: int, minute: int, runs: Sequence[Run]) -> None:
    hour = minute - minute % HOUR
    minutes = tables.rollup_row(connection, "minutes", unit, hour)
    minutes = replace_row(minutes, rollup(runs, minute))
    tables.write_rollups(connection, "minutes", unit, hour, minutes)
    day = hour - hour % DAY
    hours = tables.rollup_row(connection, "hours", unit, day)
    tables.write_rollups(connection, "hours", unit, day, replace_row(hours, combine(minutes, hour)))


def _bits(connection: tables.StoreConnection, unit: int, minute: int, runs: Sequence[Run]) -> None:
    stored = tables.bits_around(connection, unit, minute, minute + MINUTE)
    if not stored:
        since, until = minute, minute + MINUTE
    else:
        since, until = stored[0].at, max(stored[-1].until, minute + MINUTE)
    marks = tables.link_marks(connection, unit, since, until)
    tables.replace_bits(connection, unit, stored, splice(stored, minute, runs, marks))
