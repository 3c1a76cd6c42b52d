"""The spool as files: records appended and synced, read in order, removed once they are stored.

Only the writer's thread uses it. A folder belongs to one server; ``spool.json`` names it, so that the store
knows how far it has followed.
"""

from __future__ import annotations

import errno
import os
import secrets
from bisect import bisect_right
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import structlog

from app.database.private import make_file, make_folder, sync_folder, write_file
from app.database.sqlite.reserve import free_bytes
from app.history.intake.updates import Delivery
from app.history.spool.records import Facts, Record, SpooledUpdate, pack, records_in, unpack
from app.history.spool.segments import Segment, SpoolContents, contents_of, to_give_up
from bus.instants import UnixTime

SEGMENTS = 32
"""Into how many files the bound is divided: so much is given up at a time."""
_ENDING = ".spool"
_STATE = "spool.json"
log = structlog.get_logger()


class SpoolState(msgspec.Struct):
    """State beside the records. ``next``: a number above all that were given; ``lost``: readings that
    gave way, since ``since`` (Unix time), when the database was first missed."""

    id: str
    next: int = 1
    since: UnixTime | None = None
    lost: int = 0


class Spool:
    """At most ``most`` bytes in a folder, while the disk has more than ``min_free`` left."""

    def __init__(
        self, folder: Path, most: int, min_free: int = 0, free: Callable[[Path], int] = free_bytes
    ) -> None:
        self._folder, self._most, self._min_free, self._free = folder, most, min_free, free
        self._file: int | None = None
        self._reading: tuple[tuple[int, int], list[Record]] = ((0, 0), [])
        make_folder(folder)
        found = [_segment(path) for path in sorted(folder.glob(f"*{_ENDING}"))]
        self._segments = [segment for segment in found if segment.last]
        for torn in found:
            # Its name is that of the next one.
            if not torn.last:
                self._path(torn).unlink()
        self.state = self._read_state()
        self._next = max([self.state.next, *(segment.last + 1 for segment in self._segments)])

    @property
    def contents(self) -> SpoolContents:
        return contents_of(self._segments)

    def note(self, since: UnixTime | None) -> None:
        """The database is missed since then, or no longer (None): then the count of what was lost begins
        again."""
        self.state.since = since
        if since is None:
            self.state.lost = 0
        self._write_state()

    def append(self, deliveries: Sequence[Delivery], *, is_repeated: bool = False) -> None:
        """On disk when this returns. The oldest gives way where the bound is reached. Raises OSError; then it
        may be on disk, and is repeated."""
        packed = pack(self._next, deliveries, is_repeated=is_repeated)
        if packed is None:
            return
        self._make_room(len(packed))
        (record,) = records_in(packed)
        self._next += 1
        try:
            self._write(packed)
        except OSError:
            self._withdraw()
            raise
        self._segments[-1].add(record.facts, len(packed))
        if self._segments[-1].size >= self._most // SEGMENTS:
            self.close()

    def read(self, after: int) -> tuple[Facts, list[tuple[str, list[SpooledUpdate]]]] | None:
        """The oldest record with a greater number; one that cannot be read is passed over."""
        for segment in self._segments:
            if segment.last <= after:
                continue
            records = self._records(segment)
            for record in records[bisect_right(records, after, key=_number) :]:
                try:
                    return record.facts, unpack(record.content)
                except ValueError as error:
                    log.error("history", spool=str(error))
        return None

    def drop(self, through: int) -> None:
        """Remove what is stored: all up to this number."""
        stored = [segment for segment in self._segments if segment.last <= through]
        if stored and len(stored) == len(self._segments):
            self.state.next = self._next
            self._write_state()
        for segment in stored:
            self._remove(segment)

    def newest(self, bus: str) -> UnixTime | None:
        """The time of the newest update of a bus. Any thread calls it."""
        for segment in reversed(tuple(self._segments)):
            with suppress(OSError, ValueError):
                found = records_in(self._path(segment).read_bytes())
                kept = [updates for each in found for owner, updates in unpack(each.content) if owner == bus]
                if kept:
                    return max(update.at for updates in kept for update in updates)
        return None

    def close(self) -> None:
        """Begin another file with the next record."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _make_room(self, needed: int) -> None:
        self._give_up(to_give_up(self._segments, needed, self._most))
        while self._free(self._folder) < self._min_free:
            if len(self._segments) < 2:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._give_up(self._segments[:1])

    def _give_up(self, segments: Sequence[Segment]) -> None:
        if segments:
            self.state.lost += sum(segment.readings for segment in segments)
            self._write_state()
        for segment in segments:
            self._remove(segment)

    def _write(self, packed: bytes) -> None:
        if self._file is None:
            segment = Segment(self._next - 1)
            path = self._path(segment)
            make_file(path)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
            sync_folder(self._folder)
            self._segments.append(segment)
        written = 0
        while written < len(packed):
            written += os.write(self._file, packed[written:])
        os.fdatasync(self._file)

    def _withdraw(self) -> None:
        """Cut off what may be written of a record, as far as the disk allows it."""
        if self._file is not None:
            with suppress(OSError):
                os.ftruncate(self._file, self._segments[-1].size)
            self.close()

    def _remove(self, segment: Segment) -> None:
        if segment is self._segments[-1]:
            self.close()
        self._segments.remove(segment)
        self._path(segment).unlink(missing_ok=True)

    def _records(self, segment: Segment) -> list[Record]:
        key = segment.first, segment.last
        if self._reading[0] != key:
            self._reading = key, list(records_in(self._path(segment).read_bytes()))
        return self._reading[1]

    def _path(self, segment: Segment) -> Path:
        return self._folder / f"{segment.first:020d}{_ENDING}"

    def _read_state(self) -> SpoolState:
        with suppress(OSError, msgspec.MsgspecError):
            return msgspec.json.decode((self._folder / _STATE).read_bytes(), type=SpoolState)
        state = SpoolState(secrets.token_hex(8))
        write_file(self._folder / _STATE, msgspec.json.encode(state))
        return state

    def _write_state(self) -> None:
        write_file(self._folder / _STATE, msgspec.json.encode(self.state))


def _number(record: Record) -> int:
    return record.facts.number


def _segment(path: Path) -> Segment:
    segment, stop = Segment(int(path.stem)), 0
    for record in records_in(path.read_bytes()):
        segment.damaged += record.start > stop
        segment.add(record.facts, record.stop - record.start)
        stop = record.stop
    return segment
