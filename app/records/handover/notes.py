"""Notes of shifts, and their pictures in a store beside the main one, as a large write must not delay a
command.

Notes are limited: to recent shifts, to a rate, and to the free disk space. A note is written once; a
correction is a new note that names the earlier one.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields, replace
from functools import partial
from math import ceil
from pathlib import Path

import structlog

from app.core.database import Database, StoreConnection
from app.core.database.connection import size_of
from app.core.database.files import MIN_FREE_OF_OTHERS, free_bytes
from app.core.web.routes import RateLimit
from app.errors import Problem, StoreError
from app.line.alarms.journal import JournalEntry
from app.records.handover.rules import PlainPicture, Shift, plain_picture
from bus.instants import DAY_S, HOUR_S, Clock, UnixTime, monotonic_now, unix_now
from bus.messages import Message
from bus.pacing import Bucket

MAX_AGE_DAYS = 31
"""The time after its end in which a shift takes notes and signatures: a plant may be closed for weeks."""
MAX_PER_HOUR = 60
"""The notes and pictures of one person: at most this many at once and in an hour."""


class Quota:
    """A limit on the data that each person stores. ``folder``: the folder of the stores."""

    def __init__(self, folder: Path, clock: Clock = unix_now) -> None:
        self._folder = folder
        self._clock = clock
        self._taken: defaultdict[str, Bucket] = defaultdict(
            partial(Bucket, MAX_PER_HOUR / HOUR_S, MAX_PER_HOUR)
        )

    def is_recent(self, shift: Shift) -> bool:
        """Return whether a shift still takes notes and signatures."""
        return shift.end >= self._clock() - MAX_AGE_DAYS * DAY_S

    def check(self, shift: Shift) -> None:
        """Raise Problem 409 for a shift of long ago, 503 if the disk space is kept for commands."""
        if not self.is_recent(shift):
            raise Problem(409, "not_in_state", Message.of("shift_too_old", n=MAX_AGE_DAYS))
        if free_bytes(self._folder) < MIN_FREE_OF_OTHERS:
            raise Problem(503, "store", Message("shift_disk_full"))

    def count_note(self, sender: str, parts: int) -> None:
        """Count a note with its pictures. Raise Problem 429 after too many of one sender."""
        bucket, now = self._taken[sender], monotonic_now()
        if not bucket.take(now, parts):
            problem = Problem(429, "too_many", Message.of("shift_quota_used", n=MAX_PER_HOUR))
            problem.headers.update(self.rate_limit(sender).headers)
            raise problem.with_headers(Retry_After=str(ceil(bucket.wait_s(now, parts))))

    def rate_limit(self, sender: str) -> RateLimit:
        """Return the amount that this sender may still store."""
        return RateLimit.of_bucket(self._taken[sender], monotonic_now())


MAX_NOTES = 500
"""The most notes of a shift: people have to read a sheet."""
MAX_OF_SPAN = 200
"""The most notes of a span of any length: a chart has room for fewer."""
MAX_READ = 5000
MAX_PICTURES = 20
MAX_OF_SITE = 200_000
"""The most notes of all shifts: five years with 100 a day."""


@dataclass(frozen=True, slots=True)
class Note:
    """A note in the store. ``at``: the time that it is about; ``alarm``: the id of an occurrence; ``sender``:
    the account with the time of its creation; ``key``: identifies the sender's request; ``pictures``:
    digests, separated by blanks."""

    at: UnixTime
    written_at: UnixTime
    who: str
    text: str
    bus: str | None
    unit: int | None
    alarm: str | None
    corrects: int | None
    sender: str
    key: str | None
    pictures: str = ""
    id: int = 0


class RepeatedNoteError(Exception):
    """Raised for a request that was carried out before; ``note``: its result."""

    def __init__(self, note: Note) -> None:
        super().__init__(note.id)
        self.note = note


_COLUMNS = tuple(field.name for field in fields(Note) if field.name != "id")
_ENTRY = ", ".join(field.name for field in fields(JournalEntry))
_SELECT = f"SELECT {', '.join(_COLUMNS)}, id FROM shift_note"
_MARKS = ", ".join("?" * len(_COLUMNS))
_INSERT = f"INSERT INTO shift_note ({', '.join(_COLUMNS)}) VALUES ({_MARKS}) RETURNING id"


def notes_of(connection: StoreConnection, shift: Shift) -> list[Note]:
    """Return the notes of a shift in the order of the times that they are about."""
    rows = connection.execute(f"{_SELECT} WHERE at >= ? AND at < ? ORDER BY at, id", (shift.start, shift.end))
    return [Note(*row) for row in rows]


def notes_between(connection: StoreConnection, start: UnixTime, end: UnixTime) -> list[Note]:
    """Return the newest notes about times in a span, in order, without those that were corrected."""
    corrected = "SELECT corrects FROM shift_note WHERE corrects IS NOT NULL"
    query = (
        f"{_SELECT} WHERE at >= ? AND at < ? AND id NOT IN ({corrected}) ORDER BY at DESC, id DESC LIMIT ?"
    )
    return [Note(*row) for row in connection.execute(query, (start, end, MAX_READ))][::-1]


def counts_of(connection: StoreConnection, shifts: list[Shift]) -> list[int]:
    """Return the number of notes of each shift."""
    query = "SELECT count(*) FROM shift_note WHERE at >= ? AND at < ?"
    return [connection.execute(query, (shift.start, shift.end)).fetchone()[0] for shift in shifts]


def find_repeated(connection: StoreConnection, note: Note) -> Note | None:
    """Return the note that this request made before. Raise Problem 422 if its key was for another note."""
    row = connection.execute(f"{_SELECT} WHERE sender = ? AND key = ?", (note.sender, note.key)).fetchone()
    if row is None:
        return None
    earlier = Note(*row)
    same = replace(note, at=earlier.at, written_at=earlier.written_at, id=earlier.id)
    if same != earlier:
        raise Problem(422, "invalid", Message("shift_note_key_of_other"))
    return earlier


def add(connection: StoreConnection, note: Note, shift: Shift) -> int:
    """Store a note, and return its number. Raise the errors of :func:`check`."""
    check(connection, note, shift)
    [(number,)] = connection.execute(_INSERT, astuple(note)[:-1])
    return int(number)


def check(connection: StoreConnection, note: Note, shift: Shift) -> None:
    """Raise RepeatedNoteError; raise Problem 404 or 409 if the note corrects a corrected note, its alarm
    never occurred, or the shift has no room."""
    repeated = find_repeated(connection, note)
    if repeated is not None:
        raise RepeatedNoteError(repeated)
    if note.corrects is not None:
        query = "SELECT id FROM shift_note WHERE corrects = ?"
        row = connection.execute(query, (note.corrects,)).fetchone()
        if row is not None:
            message = Message.of("shift_note_superseded", note=note.corrects, newer=row["id"])
            raise Problem(409, "superseded", message, id=row["id"])
    if note.alarm is not None:
        occurrence(connection, note.alarm)
    if (connection.execute("SELECT max(id) FROM shift_note").fetchone()[0] or 0) >= MAX_OF_SITE:
        raise Problem(409, "too_many", Message.of("shift_notes_of_site_full", n=MAX_OF_SITE))
    if counts_of(connection, [shift])[0] >= MAX_NOTES:
        raise Problem(409, "too_many", Message.of("shift_notes_full", n=MAX_NOTES))
    there = sum(len(each.pictures.split()) for each in notes_of(connection, shift)) if note.pictures else 0
    if there + len(note.pictures.split()) > MAX_PICTURES:
        raise Problem(409, "too_many", Message.of("shift_pictures_full", n=MAX_PICTURES))


def occurrence(connection: StoreConnection, alarm_id: str) -> JournalEntry:
    """Return the last transition of an occurrence of an alarm. Raise Problem 404."""
    alarm, _, number = alarm_id.rpartition(".")
    query = f"SELECT {_ENTRY} FROM alarm_journal WHERE alarm = ? AND occurrence = ? ORDER BY id DESC LIMIT 1"
    is_number = number.isascii() and number.isdigit() and len(number) < 19
    row = connection.execute(query, (alarm, int(number))).fetchone() if is_number else None
    if row is None:
        raise Problem(404, "unknown_alarm", Message.of("alarm_unknown", id=alarm_id))
    return JournalEntry(*row)


def find(connection: StoreConnection, number: int, shift: Shift) -> Note:
    """Return a note of a shift. Raise Problem 404."""
    row = connection.execute(f"{_SELECT} WHERE id = ?", (number,)).fetchone()
    if row is None or not shift.holds(row["at"]):
        raise Problem(404, "unknown_note", Message.of("shift_note_unknown", note=number))
    return Note(*row)


log = structlog.get_logger()

FILE = "pictures.db"
MIGRATIONS = Path(__file__).parent / "migrations"
MAX_OF_NOTE = 3
MAX_PICTURE_BYTES = 1024**2
"""The most bytes of one picture."""
MB = 1_000_000


def judged(contents: Sequence[bytes]) -> dict[str, PlainPicture]:
    """Return the pictures by the SHA-256 of the stored content. Raise Problem 422 or CallerError."""
    if len(contents) > MAX_OF_NOTE:
        raise Problem(422, "invalid", Message.of("pictures_too_many", n=MAX_OF_NOTE))
    if any(len(content) > MAX_PICTURE_BYTES for content in contents):
        raise Problem(413, "too_large", Message.of("picture_too_long", n=MAX_PICTURE_BYTES // 1024**2))
    plain = [plain_picture(content) for content in contents]
    return {hashlib.sha256(each.content).hexdigest(): each for each in plain}


class PictureStore:
    """The store of pictures, opened with the first picture: most sites have none."""

    def __init__(self, folder: Path, max_mb: int) -> None:
        self._path = folder / FILE
        self._max_mb = max_mb
        self._opening = asyncio.Lock()
        self._database: Database | None = None

    async def add(self, pictures: dict[str, PlainPicture]) -> None:
        """Store the pictures that are not stored yet. Raise Problem 409 if there is no room for them."""
        rows = [(digest, each.media_type, each.content) for digest, each in pictures.items()]
        if rows:
            database = await self._opened()
            await database.write(lambda connection: self._insert(connection, rows))

    def _insert(self, connection: StoreConnection, rows: Sequence[tuple[str, str, bytes]]) -> None:
        if size_of(connection) + sum(len(content) for _, _, content in rows) > self._max_mb * MB:
            raise Problem(409, "too_many", Message.of("pictures_of_site_full", n=self._max_mb))
        query = "INSERT INTO picture VALUES (?, ?, ?) ON CONFLICT (digest) DO NOTHING"
        connection.executemany(query, rows)

    async def find(self, digest: str) -> PlainPicture:
        """Return a picture. Raise Problem 404, also for content that does not fit its digest; StoreError if
        the store is damaged."""
        query = "SELECT media_type, content FROM picture WHERE digest = ?"
        row = None
        if self._path.exists():
            database = await self._opened()
            row = await database.read(lambda store: store.execute(query, (digest,)).fetchone())
        if row is None or hashlib.sha256(row["content"]).hexdigest() != digest:
            raise Problem(404, "not_found", Message("no_such_picture"))
        return PlainPicture(*row)

    async def all_of(self, digests: Iterable[str]) -> dict[str, PlainPicture]:
        """Return the pictures of these digests that can be read. Damage affects only the pictures that have
        it."""
        found = {}
        for digest in digests:
            try:
                found[digest] = await self.find(digest)
            except Problem:
                continue
            except StoreError as error:
                log.error("store", picture=digest, error=str(error))
        return found

    def close(self) -> None:
        if self._database is not None:
            self._database.close()

    async def _opened(self) -> Database:
        async with self._opening:
            if self._database is None:
                self._database = await asyncio.to_thread(Database, self._path, MIGRATIONS)
            return self._database
