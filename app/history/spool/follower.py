"""Takes what was spooled into the store, in order and beside the live readings.

The spool is the journal of what follows: how far it is stored is written in the transaction that folds the
last minute of a stretch. After a crash before it the stretch is folded again, which changes nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from app.database import Database
from app.database.engine import durable
from app.history.intake.folding import Minute, fold_minutes, next_to_fold
from app.history.intake.recorder import MAX_IN_TAIL
from app.history.intake.tail import Tail
from app.history.intake.updates import Delivery, Intake
from app.history.series.runs import MINUTE
from app.history.spool.records import Facts
from app.history.spool.spool import Spool
from app.history.store import tables
from app.history.store.damage import DamagedBlock
from app.history.store.inspection import FoundDamage, set_aside
from bus.instants import Monotonic, monotonic_now


class Follower:
    """Follows one spool into one store. Made again when the database is back."""

    def __init__(self, database: Database, spool: Spool, on_damage: FoundDamage, stored: int) -> None:
        """``stored``: the number of the last record that the store has."""
        self._database, self._spool, self._on_damage = database, spool, on_damage
        self._tail, self._intake = Tail(), Intake()
        self._folding: deque[Minute] | None = None
        self._stored = self._taken = stored
        self._minute = 0

    def begin(self) -> None:
        """Remove what is stored."""
        self._spool.drop(self._stored)

    def follow(self, deadline: Monotonic) -> None:
        """Go on until ``deadline`` (monotonic seconds). Raises StoreError, OSError."""
        while monotonic_now() < deadline:
            found = self._spool.read(self._taken) if self._folding is None else None
            if found is not None and not self._is_complete(found[0]):
                self._take(*found)
            elif self._taken > self._stored:
                self._fold_some()
            else:
                return

    def _is_complete(self, next_facts: Facts) -> bool:
        """Whether the minute is over, or there is too much of it to go on."""
        is_next = next_facts.readings > 0 and next_facts.end // MINUTE != self._minute
        return len(self._tail) > 0 and (is_next or len(self._tail) >= MAX_IN_TAIL)

    def _take(self, facts: Facts, deliveries: Sequence[Delivery]) -> None:
        try:
            taken = self._database.write_now(lambda c: self._intake.take(c, deliveries))
        except BaseException:
            self._intake.forget()
            raise
        if facts.is_repeated:
            # What may be there twice is merged by minute, which a run across both would hide.
            self._tail.interrupt()
        self._tail.mark_lost(taken.lost)
        self._tail.add(taken.rows)
        if facts.is_repeated:
            self._tail.interrupt()
        if facts.readings:
            self._minute = facts.end // MINUTE
        self._taken = facts.number

    def _fold_some(self) -> None:
        if self._folding is None:
            self._folding = deque(self._tail.over(current=-1))
        keys = next_to_fold(self._folding, self._tail)
        is_last = len(keys) == len(self._folding)

        def write(connection: tables.StoreConnection) -> None:
            fold_minutes(connection, self._tail, keys)
            if is_last:
                # Then the spool no longer has it.
                durable(connection)
                tables.write_followed(connection, self._spool.state.id, self._taken)

        try:
            self._database.write_now(write)
        except DamagedBlock as found:
            set_aside(self._database, found.block, self._on_damage)
            return
        for key in keys:
            self._tail.drop(*key)
            self._folding.popleft()
        if is_last:
            self._folding, self._stored = None, self._taken
            self._spool.drop(self._stored)
