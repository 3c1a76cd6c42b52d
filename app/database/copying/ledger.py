"""How far a copy is, in a table of its target. While that table is there, no server starts on the store.

The table is made by the command, not by a step: a store that a server uses never has it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from app.database.copying.rows import Key, Tally, packed_key, unpacked_key
from app.database.engine import upsert
from app.database.store_connection import StoreConnection
from app.database.unfinished import LEDGER

MAKE = (
    f"CREATE TABLE IF NOT EXISTS {LEDGER} (item TEXT PRIMARY KEY, mark TEXT NOT NULL, place TEXT NOT NULL,"
    " done BIGINT NOT NULL, extra BIGINT NOT NULL, n BIGINT NOT NULL, size BIGINT NOT NULL,"
    " digest TEXT NOT NULL, copied BIGINT NOT NULL, copied_size BIGINT NOT NULL, copied_digest TEXT NOT NULL)"
)
_SITE = ""
"""In the place of a table: whose copy it is."""
_VALUES = (
    "mark",
    "place",
    "done",
    "extra",
    "n",
    "size",
    "digest",
    "copied",
    "copied_size",
    "copied_digest",
)
_PUT = upsert(LEDGER, ("item",), _VALUES)


@dataclass(frozen=True, slots=True)
class TableProgress:
    """How far one table is. ``after``: the last key that is copied; ``extra``: rows of the target that are to
    be removed once no other row depends on them; ``source`` and ``target``: what was read there."""

    table: str
    after: Key | None = None
    is_done: bool = False
    extra: int = 0
    source: Tally = field(default_factory=Tally)
    target: Tally = field(default_factory=Tally)

    @property
    def holds(self) -> bool:
        """Whether both sides have the same rows."""
        return self.is_done and self.source == self.target and not self.extra


def site_in(connection: StoreConnection) -> str | None:
    """Whose copy the store is; None: not noted."""
    row = connection.execute(f"SELECT mark FROM {LEDGER} WHERE item = ?", (_SITE,)).fetchone()
    return None if row is None else str(row[0])


def note_site(connection: StoreConnection, site: str) -> None:
    connection.execute(_PUT, (_SITE, site, "", 0, 0, 0, 0, "", 0, 0, ""))


def noted(connection: StoreConnection, mark: str) -> dict[str, TableProgress]:
    """By table how far the copy of a source in the state ``mark`` is."""
    query = f"SELECT item, {', '.join(_VALUES[1:])} FROM {LEDGER} WHERE mark = ? AND item <> ?"
    return {
        item: TableProgress(item, unpacked_key(place), bool(done), extra, Tally(*read), Tally(*copied))
        for item, place, done, extra, *both in connection.execute(query, (mark, _SITE)).fetchall()
        for read, copied in [(both[:3], both[3:])]
    }


def note(connection: StoreConnection, mark: str, progress: TableProgress) -> None:
    source, target = progress.source, progress.target
    place = packed_key(progress.after)
    values = (source.rows, source.size, source.digest, target.rows, target.size, target.digest)
    connection.execute(_PUT, (progress.table, mark, place, int(progress.is_done), progress.extra, *values))


def forget_tables(connection: StoreConnection) -> None:
    """The next pass begins at the first row of each table."""
    connection.execute(f"DELETE FROM {LEDGER} WHERE item <> ?", (_SITE,))


def remove(connection: StoreConnection) -> None:
    """The copy is finished: a server may use the store."""
    connection.execute(f"DROP TABLE {LEDGER}")
