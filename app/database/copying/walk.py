"""Makes one table of the target equal to that of the source, chunk by chunk in the order of the key.

Each chunk compares the rows of both sides and writes what differs, with the position, in one transaction. A
walk that was ended anywhere is continued, or done again: what is equal is not written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

from app.database.copying import ledger
from app.database.copying.ledger import TableProgress
from app.database.copying.rows import FIRST_ROWS, Chunk, CopiedRow, Key, common_end, next_limit
from app.database.copying.sides import CopyTarget, StoreSide
from app.database.copying.statements import delete_other, delete_row, update_row
from app.database.copying.tables import StoreTable
from app.database.store_connection import StoreConnection
from app.errors import ConstraintError, StoreError, StoreUnavailableError
from bus.errors import CallerError
from bus.messages import Message

T = TypeVar("T")
MAX_REMOVED = 1000


@dataclass(frozen=True, slots=True)
class Difference:
    """What makes a chunk of the target equal to the source."""

    missing: list[CopiedRow]
    changed: list[CopiedRow]
    extra: list[Key]

    def __bool__(self) -> bool:
        return bool(self.missing or self.changed or self.extra)


def difference(source: Chunk, target: Chunk) -> Difference:
    """Of two chunks that begin and end at the same keys."""
    if source.forms == target.forms:
        return Difference([], [], [])
    missing: list[CopiedRow] = []
    changed: list[CopiedRow] = []
    for key, form in source.forms.items():
        if (present := target.forms.get(key)) != form:
            (missing if present is None else changed).append(source.rows[key])
    return Difference(missing, changed, [key for key in target.forms if key not in source.forms])


@dataclass(frozen=True, slots=True)
class TableWalk:
    """The copy of one table. ``mark``: the state of the source that is noted with each position.
    ``verifies``: what was written is read again, and both sides are counted and have their digest."""

    source: StoreSide
    target: CopyTarget
    table: StoreTable
    mark: str
    verifies: bool

    def follow(self, progress: TableProgress) -> Iterator[TableProgress]:
        """Copy the rest of the table; gives how far it is after each chunk. Raises StoreError."""
        limit = FIRST_ROWS
        while not progress.is_done:
            source = self._read(progress.after, limit)
            target = self.target.chunk(self.table, progress.after, limit)
            end = common_end((source, limit), (target, limit))
            limit = next_limit(limit, source)
            progress = self._take(progress, source.until(end), target.until(end), end)
            yield progress

    def remove_extra(self) -> None:
        """Remove the rows that the source does not have, once no row of another table depends on them. Those
        with the highest key go first: a row of the same table that depends on one came after it."""
        extra: list[Key] = []
        after: Key | None = None
        limit, is_over = FIRST_ROWS, False
        while not is_over:
            source, target = self._read(after, limit), self.target.chunk(self.table, after, limit)
            end = common_end((source, limit), (target, limit))
            extra += difference(source.until(end), target.until(end)).extra
            after, limit, is_over = end, next_limit(limit, source), end is None
        extra.reverse()
        for place in range(0, len(extra), MAX_REMOVED):
            self._write(Difference([], [], extra[place : place + MAX_REMOVED]), self._replace)

    def _read(self, after: Key | None, limit: int) -> Chunk:
        try:
            return self.source.chunk(self.table, after, limit)
        except StoreUnavailableError:
            raise
        except StoreError as error:
            place = "" if after is None else str(after)
            failed = Message.of("copy_unreadable", table=self.table.name, after=place, reason=error.message)
            raise StoreError(failed) from error

    def _take(self, progress: TableProgress, source: Chunk, target: Chunk, end: Key | None) -> TableProgress:
        found = difference(source, target)
        deferred = len(found.extra) if self.table.is_referenced else 0
        further = replace(
            progress,
            after=end,
            is_done=end is None,
            extra=progress.extra + deferred,
            source=progress.source.with_rows([*source.forms.values()]),
        )

        def take(connection: StoreConnection, found: Difference) -> TableProgress:
            self._replace(connection, replace(found, extra=[]) if deferred else found)
            read = Chunk({}, {})
            if self.verifies:
                # As far as the chunk went: rows that are yet to be removed are among them.
                size = len(source.rows) + len(found.extra)
                read = self.target.chunk(self.table, progress.after, size).until(end) if found else target
            known = read.only(source.forms) if deferred else read
            tally = progress.target.with_rows([*known.forms.values()])
            ledger.note(connection, self.mark, taken := replace(further, target=tally))
            return taken

        return self._write(found, take)

    def _write(self, found: Difference, work: Callable[[StoreConnection, Difference], T]) -> T:
        """Write in one transaction. A row may have what an other row had, which a later chunk changes: then
        that one is removed first, and comes again with its chunk."""
        try:
            try:
                return self.target.transaction(lambda connection: work(connection, found))
            except ConstraintError:
                return self.target.transaction(lambda connection: work(connection, self._with_room(found)))
        except StoreUnavailableError:
            raise
        except (ConstraintError, StoreError, CallerError) as error:
            keys = [*map(self._key, (*found.missing, *found.changed)), *found.extra] or [()]
            names = {"table": self.table.name, "first": str(min(keys)), "last": str(max(keys))}
            raise StoreError(Message.of("copy_refused", **names, reason=error.message)) from error

    def _with_room(self, found: Difference) -> Difference:
        """Remove the rows of the target that are in the way, changed ones among them."""
        added, at = [*found.missing, *found.changed], self.table.columns.index
        changed = [self._key(row) for row in found.changed]
        self.target.connection.executemany(delete_row(self.table), changed)
        for columns in self.table.unique:
            places = [at(name) for name in columns]
            rows = [(*(row[place] for place in places), *self._key(row)) for row in added]
            self.target.connection.executemany(delete_other(self.table, columns), rows)
        return Difference(added, [], found.extra)

    def _replace(self, connection: StoreConnection, found: Difference) -> None:
        if found.extra:
            connection.executemany(delete_row(self.table), found.extra)
        if found.missing:
            self.target.insert(self.table, found.missing)
        if found.changed:
            places = self.table.places
            rows = [
                (*(value for place, value in enumerate(row) if place not in places), *self._key(row))
                for row in found.changed
            ]
            connection.executemany(update_row(self.table), rows)

    def _key(self, row: CopiedRow) -> Key:
        return tuple(row[place] for place in self.table.places)
