"""Copies all stores of a site, of which the first is the main one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from app.database.copying import ledger
from app.database.copying.ledger import TableProgress
from app.database.copying.places import StorePart, StorePlace
from app.database.copying.rows import Tally
from app.database.copying.sides import CopyTarget, StoreSide
from app.database.copying.statements import quoted
from app.database.copying.tables import STEPS, tables_of
from app.database.copying.walk import TableWalk
from app.database.engine import last_number, tables_in
from app.database.migration import missing_in
from app.database.unfinished import LEDGER
from app.errors import StoreError
from bus.messages import Message

RUNNING = "running"
"""The state of a source that a server changes."""


@dataclass(frozen=True, slots=True)
class CopyStep:
    """A table is that far. ``total``: its rows in the source; ``is_verified``: its sides are compared."""

    part: StorePart
    progress: TableProgress
    total: int
    is_verified: bool


@dataclass(frozen=True, slots=True)
class SiteCopy:
    """One pass over all stores. The source has been seen to be of this version. ``mark``: its state, or
    `RUNNING`: then the pass only brings the copy nearer, and verifies nothing."""

    source: StorePlace
    target: StorePlace
    parts: Sequence[StorePart]
    mark: str

    def follow(self) -> Iterator[CopyStep]:
        """Copy; gives each step that is on disk. Raises StoreError before anything is written where the
        target is not one for this site."""
        present = [part for part in self.parts if self.source.has(part)]
        site = site_of(self.source, self.parts[0])
        is_copy = False
        for part in self.parts:
            if self.target.has(part):
                with self.target.reading(part) as side:
                    is_copy = _is_copy(side, part, site) or is_copy
                    if not is_copy:
                        _refuse_other_site(side)
        for part in present:
            with self.source.reading(part) as source, self.target.writing(part) as target:
                target.transaction(lambda connection: ledger.note_site(connection, site))
                yield from self._copy(part, source, target)

    def finish(self) -> None:
        """Let servers use the target; the main store last."""
        for part in reversed(self.parts):
            if self.target.has(part):
                with self.target.writing(part) as target:
                    target.transaction(ledger.remove)

    def _copy(self, part: StorePart, source: StoreSide, target: CopyTarget) -> Iterator[CopyStep]:
        is_running = self.mark == RUNNING
        tables, steps = tables_of(part.steps), dict[str, CopyStep]()
        noted = ledger.noted(target.connection, self.mark)
        for table in tables:
            walk = TableWalk(source, target, table, self.mark, verifies=not is_running)
            progress = noted.get(table.name, TableProgress(table.name))
            if is_running and table.is_referenced:
                # Of a later instant of the source, other tables refer to rows that may be new.
                progress = TableProgress(table.name)
            step = CopyStep(part, progress, source.count(table), is_verified=not is_running)
            yield step
            for further in walk.follow(progress):
                step = replace(step, progress=further)
                if not (further.is_done and further.extra):
                    yield step
            steps[table.name] = step
            if table.numbered is not None:
                with source.in_words():
                    last = last_number(source.connection, table.name, table.numbered)
                target.number_after(table, last)
        for table in reversed(tables):
            if steps[table.name].progress.extra:
                walk = TableWalk(source, target, table, self.mark, verifies=not is_running)
                yield replace(steps[table.name], progress=_without_extra(walk, steps[table.name].progress))
        if is_running:
            target.transaction(ledger.forget_tables)


def _without_extra(walk: TableWalk, progress: TableProgress) -> TableProgress:
    """Remove what the source does not have, and count what is left."""
    walk.remove_extra()
    left = walk.target.count(walk.table)
    return replace(
        progress, extra=0, target=replace(progress.target, rows=left) if walk.verifies else Tally()
    )


def site_of(place: StorePlace, main: StorePart) -> str:
    """What distinguishes a site from others: its first event; empty before it."""
    archived = "(SELECT first_hash FROM events_archive ORDER BY last LIMIT 1)"
    stored = "(SELECT hash FROM events ORDER BY id LIMIT 1)"
    with place.reading(main) as side:
        return str(side.one(f"SELECT coalesce({archived}, {stored})") or "")


def state_of(place: StorePlace, main: StorePart) -> str:
    """What differs after a server used the stores: each start is an event."""
    with place.reading(main) as side:
        return f"stopped after {side.one('SELECT max(id) FROM events') or 0}"


def require_own_version(place: StorePlace, parts: Sequence[StorePart]) -> None:
    """Raises StoreError where the main store is missing, and where a store is of another version."""
    if not place.has(parts[0]):
        raise StoreError(Message.of("copy_source_missing", path=place.name))
    for part in parts:
        if place.has(part):
            with place.reading(part) as side:
                for step in missing_in(_steps_in(side), part.steps, side.name):
                    names = {"step": f"{step.number:04d}", "called": step.name}
                    raise StoreError(Message.of("copy_of_older_version", path=side.name, **names))


def _is_copy(side: StoreSide, part: StorePart, site: str) -> bool:
    """Whether a store is an unfinished copy of this site. Raises StoreError for one of another site."""
    tables = _tables_in(side)
    if STEPS in tables:
        missing_in(_steps_in(side), part.steps, side.name)
    if LEDGER not in tables:
        return False
    with side.in_words():
        noted = ledger.site_in(side.connection)
    # A site without an event is at its very beginning, and has one by now.
    if noted not in (None, "", site):
        raise StoreError(Message.of("copy_target_of_other_site", path=side.name))
    return True


def _refuse_other_site(side: StoreSide) -> None:
    """Raises StoreError for a store in which anything is."""
    tables = _tables_in(side)
    if tables and STEPS not in tables:
        raise StoreError(Message.of("copy_target_is_foreign", path=side.name, names=sorted(tables)[:5]))
    for table in tables - {STEPS}:
        if side.one(f"SELECT 1 FROM {quoted(table)} LIMIT 1"):
            raise StoreError(Message.of("copy_target_has_site", path=side.name, table=table))


def _tables_in(side: StoreSide) -> set[str]:
    with side.in_words():
        return set(tables_in(side.connection))


def _steps_in(side: StoreSide) -> dict[int, str]:
    if STEPS not in _tables_in(side):
        raise StoreError(Message.of("store_failed", path=side.name, reason=Message("store_foreign")))
    with side.in_words():
        return dict(side.connection.execute(f"SELECT number, name FROM {STEPS}").fetchall())
