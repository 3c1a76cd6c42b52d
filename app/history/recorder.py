"""Writes updates to the disk: commits about twice a second, and folds complete minutes.

Everything here runs on the one thread that writes (:mod:`app.history.writer`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from app.database import Database
from app.history import tables
from app.history.folding import Minute, fold_minutes, next_to_fold
from app.history.series.runs import MINUTE, SECOND, PlainRun, micros, plain_run
from app.history.series.values import DECIDING, ParameterStep
from app.history.tables import DamagedBlock
from app.history.tail import Tail
from app.history.upkeep import FoundDamage, set_aside
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message, in_english

BUS = 0
"""The number under which a bus itself has its key."""
Delivery = tuple[str, Sequence[Update]]
"""A bus and what its worker reported."""


@dataclass(slots=True)
class Taken:
    """What one transaction has, to be put into the tail once it is on disk."""

    rows: list[tuple[int, PlainRun]] = field(default_factory=list)
    lost: list[tuple[int, int]] = field(default_factory=list)
    """Units that stopped responding, and when, µs."""


class Intake:
    """Knows the keys of the units, and the last state of each link, to keep changes only."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """After a transaction that was rolled back: known values may not be on disk."""
        self._keys: dict[str, dict[int, int]] = {}
        self._links: dict[int, tuple[int, str]] = {}

    def take(self, connection: tables.StoreConnection, deliveries: Iterable[Delivery]) -> Taken:
        """Links and parameters of these deliveries, into this transaction; their readings are returned."""
        taken = Taken()
        for bus, updates in deliveries:
            keys = self._keys.setdefault(bus, {})
            for update in updates:
                if type(update) is Reading:
                    key = keys.get(update.unit) or self.key(connection, bus, update.unit)
                    taken.rows.append((key, plain_run(update)))
                elif isinstance(update, UnitLink | BusLink):
                    self._write_link(connection, bus, update, taken)
                elif isinstance(update, ParameterValue):
                    self._write_parameter(connection, bus, update)
        return taken

    def key(self, connection: tables.StoreConnection, bus: str, number: int) -> int:
        """The key of a unit, or of a bus as number 0."""
        keys = self._keys.setdefault(bus, {})
        if number not in keys:
            keys[number] = tables.unit_id(connection, bus, number)
        return keys[number]

    def _write_link(
        self, connection: tables.StoreConnection, bus: str, update: UnitLink | BusLink, taken: Taken
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
            taken.lost += [(unit, at) for unit in units]

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
"""How long after a minute its last readings are waited for."""
MAX_IN_TAIL = 400_000
"""Runs in memory at which even the current minute is folded."""
_LOOK_EVERY = 64


class Recorder:
    """Writes deliveries into the journal and the tail, and completed minutes and hours into blocks."""

    def __init__(self, database: Database, tail: Tail, on_damage: FoundDamage) -> None:
        self._database = database
        self._on_damage = on_damage
        self._tail = tail
        self._intake = Intake()
        self._folding: deque[Minute] = deque()
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

        def write(connection: tables.StoreConnection) -> Taken:
            taken = self._intake.take(connection, deliveries)
            if taken.rows:
                tables.write_journal(connection, taken.rows)
            return taken

        try:
            taken = self._database.write_now(write)
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
            self._fold_some(next_to_fold(self._folding, self._tail))

    def fold_everything(self, deadline: Monotonic = Monotonic(math.inf)) -> None:
        """The current minute too, until ``deadline`` (monotonic seconds); the journal holds the rest."""
        self._folding = deque(self._tail.over(current=-1))
        while self._folding and monotonic_now() < deadline:
            self._fold_some(next_to_fold(self._folding, self._tail))

    def _is_due(self, now: int) -> bool:
        minute = now - now % MINUTE
        self._commits += 1
        if self._commits % _LOOK_EVERY == 0 and len(self._tail) > MAX_IN_TAIL:
            self._folding.extend(self._tail.over(current=-1))
        return minute != self._folded_minute and now >= minute + GRACE

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
