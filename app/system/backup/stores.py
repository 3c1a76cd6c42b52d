"""The stores in the form in which a backup keeps them. The main one is copied whole. History and pictures are
taken apart: rows that never change again are exported once, as parts that many backups share, and what is
left is a small frame."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from app.core.database.connection import examining, has_table, open_for_reading
from app.core.database.files import in_words, make_file
from app.errors import StoreError
from app.line.history.series.runs import DAY, HOUR, MINUTE, micros
from app.line.history.service import FILE as HISTORY
from app.people.audit.proof import cuts_of
from app.records.handover.pictures import FILE as PICTURES
from app.settings import STORE_FILE
from app.system.postgresql.outbox import read_identity
from bus.instants import UnixTime
from bus.messages import Message

STORES = (HISTORY, STORE_FILE, PICTURES)
"""In the order in which they are copied: a picture is stored before its note, so that each note of the copy
has its pictures."""
_OF_UNIT = "SELECT {0}.* FROM unit CROSS JOIN {0} ON {0}.unit = unit.id AND {1} >= :start AND {1} < :end"
_BITS = (
    "SELECT bits.* FROM unit CROSS JOIN bits ON bits.unit = unit.id AND at >= coalesce("
    "(SELECT max(at) FROM bits AS former WHERE former.unit = unit.id AND at < :start), :start)"
    " AND at < :end AND until >= :start AND until < :end"
)


@dataclass(frozen=True, slots=True)
class Kind:
    """Parts of one kind: the store that they are of, and by table how the rows of one are selected."""

    store: str
    queries: Mapping[str, str]


KINDS = {
    "minute": Kind(
        HISTORY, {"raw": "SELECT * FROM raw WHERE span = 60000000 AND start >= :start AND start < :end"}
    ),
    "hour": Kind(
        HISTORY, {"raw": "SELECT * FROM raw WHERE span > 60000000 AND start >= :start AND start < :end"}
    ),
    "rest": Kind(
        HISTORY,
        {
            "minutes": _OF_UNIT.format("minutes", "start"),
            "hours": _OF_UNIT.format("hours", "start"),
            "link": _OF_UNIT.format("link", "at"),
            "bits": _BITS,
        },
    ),
    "picture": Kind(PICTURES, {"picture": "SELECT * FROM picture WHERE rowid >= :start AND rowid < :end"}),
}
LENGTHS = {"minute": 10 * MINUTE, "hour": HOUR, "rest": HOUR}
"""µs, as the store notes what changed."""
TAKEN_APART = {
    store: {table for kind in KINDS.values() if kind.store == store for table in kind.queries}
    for store in (HISTORY, PICTURES)
}
CHANGED = "changed"
"""The versions of the parts. They are not backed up: a restored part gets a version of its own."""


@dataclass(frozen=True, slots=True)
class Part:
    """Rows of a store from ``start`` to ``end``: µs, or numbers of rows. Where ``version`` is the same, the
    content is."""

    kind: str
    start: int
    end: int
    version: str

    @property
    def key(self) -> str:
        return f"{self.kind}-{self.start}-{self.end}"

    def export(self, store: sqlite3.Connection) -> bytes:
        """Return the rows as a small database; nothing where there are none."""
        count, span = 0, {"start": self.start, "end": self.end}
        with closing(sqlite3.connect(":memory:")) as copy:
            # Rows of a few kB fill small pages better.
            copy.execute("PRAGMA page_size = 1024")
            for table, query in KINDS[self.kind].queries.items():
                count += _copy_rows(store.execute(query, span), copy, table)
            return copy.serialize() if count else b""


def parts_of(name: str, store: sqlite3.Connection, now: UnixTime) -> list[Part]:
    """Return every part of a store, found without reading its content. Raises StoreError for a history that
    the running version has not yet brought up to date."""
    if name == PICTURES:
        rows = store.execute("SELECT rowid, digest FROM picture")
        return [Part("picture", row, row + 1, digest) for row, digest in rows]
    if not has_table(store, CHANGED):
        raise StoreError(Message.of("store_of_earlier_version", path=name))
    today = micros(now) - micros(now) % DAY
    versions: dict[tuple[str, int, int], list[tuple[int, int]]] = {}
    for kind, start, version in store.execute("SELECT kind, start, version FROM changed ORDER BY start"):
        # A day that is over is one part; of the present day little is written again.
        length = DAY if kind == "rest" and start < today else LENGTHS[kind]
        begin = start - start % length
        versions.setdefault((kind, begin, begin + length), []).append((start, version))
    return [Part(*span, sha256(repr(each).encode()).hexdigest()[:16]) for span, each in versions.items()]


def export_frame(name: str, store: sqlite3.Connection) -> bytes:
    """Return a store without its parts: the definition of every table, and the rows of the small ones."""
    with closing(sqlite3.connect(":memory:")) as frame:
        tables = _definitions(store, "table")
        for table, sql in tables.items():
            frame.execute(sql)
            if table not in TAKEN_APART[name] | {CHANGED}:
                _copy_rows(store.execute(f'SELECT * FROM "{table}"'), frame, table, is_new=False)
        for sql in (*_definitions(store, "index").values(), *_definitions(store, "trigger").values()):
            frame.execute(sql)
        return frame.serialize()


def assemble(frame: Path, parts: Iterable[tuple[str, Path]], place: Path) -> None:
    """Make a store at ``place``, an empty file, of a frame and its parts by key. Rows come before indexes and
    triggers: that is faster, and restored rows are no changes."""
    with in_words(place), closing(sqlite3.connect(place.as_uri(), uri=True, isolation_level=None)) as store:
        for setting in ("auto_vacuum = INCREMENTAL", "journal_mode = OFF", "synchronous = OFF"):
            store.execute(f"PRAGMA {setting}")
        with closing(open_for_reading(frame)) as source:
            tables = _definitions(source, "table")
            for table, sql in tables.items():
                store.execute(sql)
                _copy_rows(source.execute(f'SELECT * FROM "{table}"'), store, table, is_new=False)
            for key, part in parts:
                store.execute("ATTACH ? AS part", (f"{part.as_uri()}?mode=ro&immutable=1",))
                names = [row[0] for row in store.execute("SELECT name FROM part.sqlite_master")]
                store.execute("BEGIN")
                for table in names:
                    store.execute(f'INSERT INTO main."{table}" SELECT * FROM part."{table}"')
                store.execute("COMMIT")
                store.execute("DETACH part")
                if CHANGED in tables:
                    kind, start, _ = key.split("-")
                    store.execute(f"INSERT INTO {CHANGED} VALUES (?, ?, random())", (kind, int(start)))
            for kind in ("index", "trigger"):
                for sql in _definitions(source, kind).values():
                    store.execute(sql)


def _definitions(store: sqlite3.Connection, kind: str) -> dict[str, str]:
    query = (
        "SELECT name, sql FROM sqlite_master WHERE type = ? AND sql NOT NULL AND name NOT LIKE 'sqlite_%'"
        " ORDER BY rowid"
    )
    return dict(map(tuple, store.execute(query, (kind,))))


def _copy_rows(rows: sqlite3.Cursor, copy: sqlite3.Connection, table: str, *, is_new: bool = True) -> int:
    names = [column[0] for column in rows.description]
    if is_new:
        copy.execute(f'CREATE TABLE "{table}" ({", ".join(names)})')
    marks = ", ".join("?" * len(names))
    count = copy.executemany(f'INSERT INTO "{table}" VALUES ({marks})', rows).rowcount
    copy.commit()
    return count


def copy_store(store: Path, copy: Path) -> None:
    """Copy a store as it is at one instant, while others write it. Raises StoreError, also for a damaged
    one: it could not be put back."""
    make_file(copy)
    with in_words(store), closing(open_for_reading(store)) as live, closing(sqlite3.connect(copy)) as target:
        live.execute("SELECT 1 FROM sqlite_master").fetchall()
        # What fails from here on is the disk of the copy.
        with in_words(copy):
            live.backup(target)
            fault = fault_of(target)
    if fault:
        raise StoreError(Message.of("store_failed", path=str(store), reason=Message("store_is_damaged")))


def fault_of(store: sqlite3.Connection) -> str:
    """Return the first fault that SQLite finds; empty: the store is sound."""
    (verdict,) = store.execute("PRAGMA quick_check(1)").fetchone()
    return "" if verdict == "ok" else str(verdict)


def site_of(store: sqlite3.Connection) -> str | None:
    """Return what tells a site from others. None: an earlier version made the store."""
    return read_identity(store) if has_table(store, "publisher_identity") else None


def archived_in(store: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of archived events that a log names, by its name."""
    with examining(store) as connection:
        return {cut.file: cut.digest for cut in cuts_of(connection)}
