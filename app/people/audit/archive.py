"""The archive: old months of events as files of JSON lines, verified before they leave the store.

A file is written under another name, and renamed once it is on disk and was read back. Then an entry of the
log names it, and the cut of the log is stored and sealed in the same transaction. Only then are entries
removed."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import json
import os
import re
import secrets
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import structlog

from app.core.database import Database, StoreConnection
from app.core.database.connection import open_for_reading
from app.core.database.files import FILE_MODE, in_words, sync_folder
from app.core.lifespan import in_thread
from app.errors import StoreError, system_error
from app.people.audit.entry import Ends, KeyRing
from app.people.audit.log import EventLog
from app.people.audit.proof import CHUNK, Cut, Walk, add_cut, cuts_of, heads_text
from bus.instants import Clock, UnixTime, monotonic_now, unix_now
from bus.messages import Message

EVERY_S = 3600.0
"""The seconds between two checks for months that are due, and before the first check."""
LEFT_S = 86_400.0
"""The age in seconds at which an unfinished file was left by a server that ended."""
STEP_S = 60.0
"""A clock that was changed by more seconds is not trusted for an hour."""
MAX_REMOVED = 200
"""The most entries that one transaction removes, in a few milliseconds: no command waits longer."""
MAX_LINE = 1024 * 1024
"""The most characters of an entry, the longest of which has a few hundred frames. A forged file may unpack to
one endless line."""
NAME = re.compile(r"events-\d{4}-\d{2}(-[1-9]\d*)?\.jsonl\.gz")
_STAYS = "id IN (SELECT event FROM shift_signature)"
"""The entries of signatures prove the sheet of a shift, so they stay in the store."""
Entry = dict[str, Any]
log = structlog.get_logger()


class EventArchiveError(StoreError):
    """Raised when a file of the archive cannot be written or read."""


class Month(NamedTuple):
    """A month by the clock of the site."""

    year: int
    month: int

    def __str__(self) -> str:
        return f"{self.year:04d}-{self.month:02d}"

    def begins(self, zone: ZoneInfo) -> UnixTime:
        return UnixTime(datetime(self.year, self.month, 1, tzinfo=zone).timestamp())

    def after(self, months: int) -> Month:
        years, month = divmod(self.month - 1 + months, 12)
        return Month(self.year + years, month + 1)


def month_of(at: UnixTime, zone: ZoneInfo) -> Month:
    """Return the month of a time."""
    local = datetime.fromtimestamp(float(at), zone)
    return Month(local.year, local.month)


def months_due(oldest: UnixTime, now: UnixTime, keep: int, zone: ZoneInfo) -> list[Month]:
    """Return the months from that of the oldest event on that have been over for ``keep`` months or more."""
    kept, first = month_of(now, zone).after(-keep), month_of(oldest, zone)
    over = 12 * (kept.year - first.year) + kept.month - first.month
    return [first.after(months) for months in range(over)]


def write_file(folder: Path, month: Month, chunks: Iterable[Sequence[Entry]]) -> tuple[str, str]:
    """Write entries as the file of a month, and read it back; return its name and SHA-256. It replaces only a
    file with the same content: after a restore from a backup a month may have a second file. Nothing is left
    of it after a failure. Raise EventArchiveError, OSError."""
    if not folder.is_dir():
        # It may belong to a disk that is not mounted: it is not made.
        raise EventArchiveError(Message.of("audit_archive_folder_missing", folder=str(folder)))
    for left in folder.glob(".events-*"):
        if left.lstat().st_mtime < time.time() - LEFT_S:
            left.unlink()
    fresh, entries = folder / f".events-{month}.{secrets.token_hex(4)}", 0
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    with os.fdopen(os.open(fresh, flags, FILE_MODE), "wb") as file:
        try:
            # The file has no time and name in it: the same entries are the same bytes.
            with gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0) as packed:
                for chunk in chunks:
                    packed.write("".join(map(_line_of, chunk)).encode())
                    entries += len(chunk)
            file.flush()
            os.fsync(file.fileno())
            if sum(1 for _ in entries_in(fresh)) != entries:
                raise EventArchiveError(Message.of("audit_archive_not_read_back", file=str(fresh)))
            digest = digest_of(fresh)
            names = (f"events-{month}{f'-{number}' * (number > 1)}.jsonl.gz" for number in count(1))
            path = next(path for name in names if _is_free_for(path := folder / name, digest))
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
    sync_folder(folder)
    return path.name, digest


def _line_of(entry: Entry) -> str:
    return json.dumps({name: value for name, value in entry.items() if value is not None}) + "\n"


def _is_free_for(path: Path, digest: str) -> bool:
    return not os.path.lexists(path) or (path.is_file() and digest_of(path) == digest)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hex. Raise OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def entries_in(path: Path) -> Iterator[Entry]:
    """Yield the entries of a file as the store had them, without ``part_of``. Raise EventArchiveError,
    OSError."""
    try:
        if not path.is_file():
            raise ValueError("no file")
        with gzip.open(path, "rt", encoding="utf-8") as lines:
            while line := lines.readline(MAX_LINE):
                yield _entry_of(line)
    except (EOFError, RecursionError, ValueError, zlib.error, gzip.BadGzipFile) as error:
        raise EventArchiveError(Message.of("audit_archive_unreadable", file=path.name)) from error


def _entry_of(line: str) -> Entry:
    entry = json.loads(line)
    if not isinstance(entry, Mapping) or not isinstance(entry.get("id"), int):
        raise ValueError("no entry")
    if any(isinstance(value, dict | list) for value in entry.values()):
        raise ValueError("no row of the store")
    return {name: value for name, value in entry.items() if name != "part_of"}


@dataclass(frozen=True, slots=True)
class ArchiveProof:
    """The number of archived ``entries`` that are proven, and the files that are ``absent``."""

    entries: int = 0
    absent: tuple[str, ...] = ()


def prove_archive(
    cuts: Sequence[Cut], folder: Path | None, ring: KeyRing, anchors: Mapping[int, str]
) -> ArchiveProof:
    """Verify the files of all cuts that are in a folder, each of which continues the one before. Raise
    EventArchiveError for the first that is not as it was written, OSError for one that cannot be read."""
    entries, absent = 0, []
    start: Ends | None = None
    expected = cuts[0].first if cuts else 0
    for cut in cuts:
        if not cut.is_sealed(ring) or cut.first != expected:
            raise EventArchiveError(Message.of("audit_archive_forged", file=cut.file))
        path = folder / cut.file if folder else None
        if path is None or not path.exists():
            absent.append(cut.file)
        else:
            _prove_file(path, cut, Walk(ring, anchors, start))
            entries += cut.last - cut.first + 1
        start, expected = cut.ends, cut.last + 1
    return ArchiveProof(entries, tuple(absent))


def _prove_file(path: Path, cut: Cut, walk: Walk) -> None:
    entries = entries_in(path)
    while chunk := [*islice(entries, CHUNK)]:
        walk.follow(chunk)
        if walk.fault is not None:
            raise EventArchiveError(Message.of("audit_archive_altered_at", file=cut.file, reason=walk.fault))
    if digest_of(path) != cut.digest or _plain(walk.ends) != _plain(cut.ends):
        raise EventArchiveError(Message.of("audit_archive_altered", file=cut.file))


def _plain(ends: Ends) -> set[tuple[str, int, str]]:
    return {(chain, head.id, head.hash) for chain, head in ends.items()}


class _Due(NamedTuple):
    """Entries that are to be archived as a month."""

    month: Month
    first: int
    last: int


class EventArchive:
    """The archive of one store. ``folder`` None: all events stay in the store."""

    def __init__(
        self,
        database: Database,
        events: EventLog,
        folder: Path | None,
        keep_months: int,
        zone: ZoneInfo,
        clock: Clock = unix_now,
    ) -> None:
        self.failing: Message | None = None
        """The reason why the last attempt to archive old events failed; usually None."""
        self._database, self._events = database, events
        self._folder, self._keep, self._zone = folder, keep_months, zone
        self._clock = clock

    async def follow(self) -> None:
        """Archive due months every hour, until canceled."""
        while True:
            ahead = float(self._clock()) - float(monotonic_now())
            await asyncio.sleep(EVERY_S)
            if abs(float(self._clock()) - float(monotonic_now()) - ahead) < STEP_S:
                await self.archive_due()

    async def archive_due(self) -> None:
        """Archive all months that are due. A failure is an event and :attr:`failing`, and is retried."""
        try:
            await self._remove_archived()
            while cut := await in_thread(self._write_next):
                what = Message.of("event_archived", first=cut.first, last=cut.last, file=cut.file)
                digest = Message.of("event_archived_digest", digest=cut.digest)
                add = partial(add_cut, cut=cut)
                await self._events.record(kind="audit", what=what, message=digest, also=add)
                await self._remove_archived()
        except StoreError as error:
            await self._failed(error.message)
        else:
            self.failing = None

    async def _failed(self, reason: Message) -> None:
        log.error("events not archived", folder=str(self._folder), why=str(reason))
        is_known_already = self.failing is not None
        self.failing = reason
        if not is_known_already:
            try:
                await self._events.record(kind="audit", what=Message("event_archive_failed"), message=reason)
            except StoreError as error:
                log.error("failure of the archive not logged", why=str(error))

    def _write_next(self) -> Cut | None:
        """Write the next file of the archive; return its cut, sealed, or None if nothing is due."""
        path, ring = self._database.path, self._events.keys.ring
        if self._folder is None:
            return None
        with in_words(path), closing(open_for_reading(path)) as connection:
            before = self._newest_cut(connection)
            due = self._next_due(connection, before.last if before else 0)
            if due is None:
                return None
            walk = Walk(ring, start=before.ends if before else None)
            try:
                name, digest = write_file(self._folder, due.month, _verified(connection, walk, due))
            except OSError as error:
                raise EventArchiveError(system_error(error)) from error
        cut = Cut(due.last, due.first, name, digest, "", heads_text(walk.ends), self._clock())
        return cut.sealed(ring)

    def _newest_cut(self, connection: StoreConnection) -> Cut | None:
        noted = cuts_of(connection)
        if noted and not noted[-1].is_sealed(self._events.keys.ring):
            raise EventArchiveError(Message.of("audit_archive_forged", file=noted[-1].file))
        return noted[-1] if noted else None

    def _next_due(self, connection: StoreConnection, cut: int) -> _Due | None:
        """Return the next entries to archive after number ``cut``. They end before the first entry of a later
        month, so that a clock that is ahead cannot archive the newest ones."""
        now = self._clock()
        oldest = _first_after(connection, cut, UnixTime(0.0), now)
        for month in months_due(oldest[1], now, self._keep, self._zone) if oldest else ():
            later = _first_after(connection, cut, month.after(1).begins(self._zone), now)
            if later is None:
                return None
            until = _before_unfinished(connection, first=cut + 1, last=later[0] - 1)
            if until > cut:
                return _Due(month, cut + 1, until)
        return None

    async def _remove_archived(self) -> None:
        """Remove archived entries, in short transactions."""
        if await self._database.read(self._newest_cut) is None:
            return
        while await self._database.write(_remove_some):
            continue


def _first_after(
    connection: StoreConnection, number: int, since: UnixTime, until: UnixTime
) -> tuple[int, UnixTime] | None:
    """Return number and time of the first entry after a number with a time in a span; other times come from a
    clock that was wrong."""
    query = "SELECT id, time FROM events WHERE id > ? AND time > 0 AND time >= ? AND time <= ? ORDER BY id"
    row = connection.execute(f"{query} LIMIT 1", (number, float(since), float(until))).fetchone()
    return None if row is None else (row[0], UnixTime(row[1]))


def _before_unfinished(connection: StoreConnection, first: int, last: int) -> int:
    """Return the highest number up to ``last`` after which the log can be cut without separating a command
    from its result or a change from its parts."""
    while True:
        span = (first, last, last)
        about = "SELECT min(about) FROM events WHERE about >= ? AND about <= ? AND id > ?"
        change = "SELECT min(change) FROM event_parts WHERE change >= ? AND change <= ? AND event > ?"
        found = [connection.execute(query, span).fetchone()[0] for query in (about, change)]
        parted = min((number for number in found if number is not None), default=None)
        if parted is None:
            return last
        last = parted - 1


def _verified(connection: StoreConnection, walk: Walk, due: _Due) -> Iterator[list[Entry]]:
    """Yield entries as they are stored, chunk by chunk, each with the change that it is a part of as
    ``part_of``. Raise EventArchiveError if the log was altered: it then stays as evidence."""
    query = (
        "SELECT e.*, p.change AS part_of FROM events e LEFT JOIN event_parts p ON p.event = e.id "
        "WHERE e.id >= ? AND e.id <= ? ORDER BY e.id LIMIT ?"
    )
    first = due.first
    while chunk := [dict(row) for row in connection.execute(query, (first, due.last, CHUNK))]:
        walk.follow({name: each[name] for name in each if name != "part_of"} for each in chunk)
        if walk.fault is not None:
            raise EventArchiveError(Message.of("audit_archive_of_altered", reason=walk.fault))
        yield chunk
        first = chunk[-1]["id"] + 1


def _remove_some(connection: StoreConnection) -> bool:
    """Remove some archived entries, the newest first, so that a result goes before its command; return
    whether there may be more."""
    query = (
        f"SELECT max(id) FROM events WHERE id <= (SELECT max(last) FROM events_archive) AND NOT ({_STAYS})"
    )
    [top] = connection.execute(query).fetchone()
    if top is None:
        return False
    span = (top - MAX_REMOVED, top)
    connection.execute("DELETE FROM event_parts WHERE event > ? AND event <= ?", span)
    connection.execute(f"DELETE FROM events WHERE id > ? AND id <= ? AND NOT ({_STAYS})", span)
    return True
