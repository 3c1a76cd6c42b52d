"""The contents of a backup: the stores of a site, and the files beside them.

The main store is copied whole. History and pictures are taken apart: rows that never change again are
exported once, as parts that many backups share, and the rest is a small frame.

The files are the configuration with its versions and the files that it names, such as the key of the audit
log, certificates with their keys, and the files of passwords. In a backup they are one member, encrypted if
``[backup] key_file`` names a key: AES-256 in counter mode, sealed by HMAC-SHA-256. Without a key the member
has only the configuration and its versions. Its layout is 16 bytes of salt, 32 of the seal over the salt and
the rest, then the rest. The keys of a backup come from the key file and from its salt, which no other backup
has.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path, PurePosixPath

import msgspec
from pydantic import BaseModel

from app.core.database.connection import examining, has_table, open_for_reading
from app.core.database.files import in_words, make_file, make_folder, write_file
from app.errors import StoreError
from app.line.history.series.runs import DAY, HOUR, MINUTE, micros
from app.line.history.service import FILE as HISTORY
from app.people.audit.keys import find_key_file
from app.people.audit.proof import cuts_of
from app.records.handover.notes import FILE as PICTURES
from app.settings import STORE_FILE, Settings
from app.system.configuration.document import VersionStore
from app.system.postgresql.outbox import read_identity
from bus.instants import UnixTime
from bus.messages import Message

STORES = (HISTORY, STORE_FILE, PICTURES)
"""The order of copying: a picture is stored before its note, so that the copy has the pictures of each of its
notes."""
_OF_UNIT = "SELECT {0}.* FROM unit CROSS JOIN {0} ON {0}.unit = unit.id AND {1} >= :start AND {1} < :end"
_BITS = (
    "SELECT bits.* FROM unit CROSS JOIN bits ON bits.unit = unit.id AND at >= coalesce("
    "(SELECT max(at) FROM bits AS former WHERE former.unit = unit.id AND at < :start), :start)"
    " AND at < :end AND until >= :start AND until < :end"
)


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of parts: its store, and the query for the rows of each table."""

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
"""The length of parts in µs, as the store notes changes."""
TAKEN_APART = {
    store: {table for kind in KINDS.values() if kind.store == store for table in kind.queries}
    for store in (HISTORY, PICTURES)
}
CHANGED = "changed"
"""The versions of the parts. They are not backed up: a restored part gets its own version."""
_NOT_COPIED = {CHANGED, "figures"}
"""Figures are computed again from the restored rows."""


@dataclass(frozen=True, slots=True)
class Part:
    """The rows of a store from ``start`` to ``end``: µs, or numbers of rows. An equal ``version`` means equal
    content."""

    kind: str
    start: int
    end: int
    version: str

    @property
    def key(self) -> str:
        return f"{self.kind}-{self.start}-{self.end}"

    def export(self, store: sqlite3.Connection) -> bytes:
        """Return the rows as a small database; empty if there are none."""
        count, span = 0, {"start": self.start, "end": self.end}
        with closing(sqlite3.connect(":memory:")) as copy:
            # Rows of a few kB fill small pages better.
            copy.execute("PRAGMA page_size = 1024")
            for table, query in KINDS[self.kind].queries.items():
                count += _copy_rows(store.execute(query, span), copy, table)
            return copy.serialize() if count else b""


def parts_of(name: str, store: sqlite3.Connection, now: UnixTime) -> list[Part]:
    """Return every part of a store, found without reading its content. Raise StoreError for a history that
    the running version has not yet brought up to date."""
    if name == PICTURES:
        rows = store.execute("SELECT rowid, digest FROM picture")
        return [Part("picture", row, row + 1, digest) for row, digest in rows]
    if not has_table(store, CHANGED):
        raise StoreError(Message.of("store_of_earlier_version", path=name))
    today = micros(now) - micros(now) % DAY
    versions: dict[tuple[str, int, int], list[tuple[int, int]]] = {}
    for kind, start, version in store.execute("SELECT kind, start, version FROM changed ORDER BY start"):
        # A past day is one part; of the present day only a little is written again.
        length = DAY if kind == "rest" and start < today else LENGTHS[kind]
        begin = start - start % length
        versions.setdefault((kind, begin, begin + length), []).append((start, version))
    return [Part(*span, sha256(repr(each).encode()).hexdigest()[:16]) for span, each in versions.items()]


def export_frame(name: str, store: sqlite3.Connection) -> bytes:
    """Return a store without its parts: each table's definition, and the rows of small tables."""
    with closing(sqlite3.connect(":memory:")) as frame:
        tables = _definitions(store, "table")
        for table, sql in tables.items():
            frame.execute(sql)
            if table not in TAKEN_APART[name] | _NOT_COPIED:
                _copy_rows(store.execute(f'SELECT * FROM "{table}"'), frame, table, is_new=False)
        for sql in (*_definitions(store, "index").values(), *_definitions(store, "trigger").values()):
            frame.execute(sql)
        return frame.serialize()


def assemble(frame: Path, parts: Iterable[tuple[str, Path]], place: Path) -> None:
    """Make a store at ``place``, an empty file, from a frame and its parts by key. Rows come before indexes
    and triggers: that is faster, and restored rows do not count as changes."""
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
    """Copy a store as it is at one instant, while others write it. Raise StoreError, also for a damaged
    store, which could not be restored."""
    make_file(copy)
    with in_words(store), closing(open_for_reading(store)) as live, closing(sqlite3.connect(copy)) as target:
        live.execute("SELECT 1 FROM sqlite_master").fetchall()
        # A failure from here on comes from the disk of the copy.
        with in_words(copy):
            live.backup(target)
            fault = fault_of(target)
    if fault:
        raise StoreError(Message.of("store_failed", path=str(store), reason=Message("store_is_damaged")))


def fault_of(store: sqlite3.Connection) -> str:
    """Return the first fault that SQLite finds; empty if the store is sound."""
    (result,) = store.execute("PRAGMA quick_check(1)").fetchone()
    return "" if result == "ok" else str(result)


def site_of(store: sqlite3.Connection) -> str | None:
    """Return the identity of a store's site; None if an earlier version made the store."""
    return read_identity(store) if has_table(store, "publisher_identity") else None


def archived_in(store: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of archived events that a log names, by name."""
    with examining(store) as connection:
        return {cut.file: cut.digest for cut in cuts_of(connection)}


MIN_KEY_CHARACTERS, MAX_KEY_BYTES = 32, 4096
SALT_BYTES, SEAL_BYTES = 16, 32
PBKDF2_ROUNDS = 10_000
"""The rounds of ``openssl enc -pbkdf2``, which version 0.2 called; the password is random."""


def read_key(file: Path) -> bytes:
    """Return the key in a file, without white space around it. Raise StoreError if there is none."""
    try:
        with file.open("rb") as opened:
            key = opened.read(MAX_KEY_BYTES).strip()
    except OSError as error:
        raise StoreError(Message.of("backup_key_missing", file=str(file))) from error
    if len(key) < MIN_KEY_CHARACTERS:
        raise StoreError(Message.of("backup_key_short", file=str(file), n=MIN_KEY_CHARACTERS))
    return key


def encrypt(content: bytes, key: bytes) -> bytes:
    """Encrypt the content with a key."""
    salt = secrets.token_bytes(SALT_BYTES)
    password, seal_key = _keys(key, salt)
    hidden = _counted(content, password)
    return salt + _seal(seal_key, salt, hidden) + hidden


def decrypt(packed: bytes, key: bytes) -> bytes:
    """Decrypt a packed content. Raise StoreError if it has another key or was altered."""
    salt, seal, hidden = (
        packed[:SALT_BYTES],
        packed[SALT_BYTES:][:SEAL_BYTES],
        packed[SALT_BYTES + SEAL_BYTES :],
    )
    password, seal_key = _keys(key, salt)
    if not hmac.compare_digest(seal, _seal(seal_key, salt, hidden)):
        raise StoreError(Message("backup_key_wrong"))
    return _counted(hidden, password)


def _keys(key: bytes, salt: bytes) -> tuple[bytes, bytes]:
    both = hashlib.scrypt(key, salt=salt, n=2**14, r=8, p=1, dklen=64)
    return both[:32], both[32:]


def _seal(key: bytes, salt: bytes, hidden: bytes) -> bytes:
    return hmac.digest(key, salt + hidden, "sha256")


def _counted(content: bytes, password: bytes) -> bytes:
    """Encrypt or decrypt in counter mode, in which both are the same."""
    # Imported only here: a server whose backups have no key saves the memory of the module.
    from cryptography.hazmat.primitives.ciphers import Cipher
    from cryptography.hazmat.primitives.ciphers.algorithms import AES256
    from cryptography.hazmat.primitives.ciphers.modes import CTR

    derived = hashlib.pbkdf2_hmac("sha256", password.hex().encode(), b"", PBKDF2_ROUNDS, 48)
    return Cipher(AES256(derived[:32]), CTR(derived[32:])).encryptor().update(content)


IN_CLEAR, ENCRYPTED = "files.json", "files.encrypted"
MAX_FILE_BYTES = 4 * 2**20
MAX_BYTES = 64 * 2**20
"""The most bytes of the member with the files."""


class SiteFile(msgspec.Struct):
    """A file of a site. ``path``: its absolute path in the site."""

    path: str
    content: bytes


class SiteFiles(msgspec.Struct):
    """The files of a site in a backup. ``left_out``: files that it lacks, as there is no key to encrypt
    them."""

    member: str
    content: bytes
    left_out: list[str]


def files_of(settings: Settings) -> SiteFiles:
    """Read the files of a site as the member of a backup. Raise StoreError, also if the key of the backups is
    in their folder: a person with one would have the other."""
    configuration = [settings._file] if settings._file is not None else []
    configuration += VersionStore(settings.server.data).files
    named = sorted({path for path in _named(settings) if path.is_file()} - {settings.backup.key_file})
    if settings.backup.key_file is None:
        return SiteFiles(IN_CLEAR, _packed(configuration), [str(path) for path in named])
    key_file, folder = settings.backup.key_file, settings.backup.folder
    if folder is not None and key_file.resolve().is_relative_to(folder.resolve()):
        raise StoreError(Message.of("backup_key_in_folder", file=str(key_file)))
    content = encrypt(_packed([*configuration, *named]), read_key(key_file))
    return SiteFiles(ENCRYPTED, content, [])


def place_files(member: str, content: bytes, key_file: Path | None, folder: Path) -> list[Path]:
    """Write the files of a backup below a folder, which must not exist yet, each under its path. Raise
    StoreError, also for a path that leads out of the folder."""
    if member == ENCRYPTED:
        if key_file is None:
            raise StoreError(Message("backup_needs_key"))
        content = decrypt(content, read_key(key_file))
    try:
        files = msgspec.json.decode(content, type=list[SiteFile])
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise StoreError(Message("backup_files_damaged")) from error
    places = [(_below(folder, file.path), file.content) for file in files]
    if folder.exists():
        raise StoreError(Message.of("backup_exists", file=str(folder)))
    make_folder(folder)
    for place, written in places:
        make_folder(place.parent)
        write_file(place, written)
    return [place for place, _ in places]


def _named(settings: Settings) -> Iterator[Path]:
    """Yield every file that the configuration names and a restore needs. An anchor is evidence of this log,
    and has its own place."""
    yield from _paths_in(settings)
    if (key_file := find_key_file(settings.key_files)) is not None:
        yield key_file


def _paths_in(model: BaseModel) -> Iterator[Path]:
    for name, value in model:
        if isinstance(value, Path) and name != "anchor":
            yield value
        for inside in value if isinstance(value, tuple) else (value,):
            if isinstance(inside, BaseModel):
                yield from _paths_in(inside)


def _packed(paths: Sequence[Path]) -> bytes:
    files = []
    for path in paths:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise StoreError(Message.of("backup_file_too_large", file=str(path), most=MAX_FILE_BYTES))
        files.append(SiteFile(str(path), path.read_bytes()))
    return msgspec.json.encode(files)


def _below(folder: Path, path: str) -> Path:
    """Return the place below the folder for a path of a backup, which may be forged."""
    pure = PurePosixPath(path)
    if not pure.is_absolute() or ".." in pure.parts or "\0" in path:
        raise StoreError(Message("backup_files_damaged"))
    return folder.joinpath(*pure.parts[1:])
