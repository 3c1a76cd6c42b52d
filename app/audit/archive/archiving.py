"""Moves old events into the archive: written and verified first, then removed from the store."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path
from typing import NamedTuple
from zoneinfo import ZoneInfo

import structlog

from app.audit.archive import cuts
from app.audit.archive.cut import Cut, heads_text
from app.audit.archive.file import ArchiveWriter, EventArchiveError
from app.audit.archive.month import is_known, months_due
from app.audit.log import EventLog
from app.audit.proof.walk import Walk
from app.database import Database
from app.errors import StoreError, StoreUnavailableError, system_error
from app.server.in_thread import in_thread
from bus.instants import Clock, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message

EVERY_S = 3600.0
"""How often it is looked whether a month is due, the first time so long after the start."""
STEP_S = 60.0
"""A clock that was set by more is not trusted for an hour."""
CHUNK = 500
log = structlog.get_logger()


class _Due(NamedTuple):
    """Entries that are to be archived under the name of a month."""

    month: str
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
        monotonic: MonotonicClock = monotonic_now,
    ) -> None:
        self.failing: Message | None = None
        """Why old events could not be archived at the last attempt; mostly None."""
        self._database, self._events = database, events
        self._folder, self._keep, self._zone = folder, keep_months, zone
        self._clock, self._monotonic = clock, monotonic

    async def follow(self) -> None:
        """Archive what is due each hour, without end."""
        while True:
            ahead = float(self._clock()) - float(self._monotonic())
            await asyncio.sleep(EVERY_S)
            if abs(float(self._clock()) - float(self._monotonic()) - ahead) < STEP_S:
                await self.archive_due()

    async def archive_due(self) -> None:
        """Archive every month that is due. A failure is an event and :attr:`failing`, and is retried."""
        try:
            await self._remove_archived()
            while self._folder is not None and (due := await self._next_due()):
                await self._archive(self._folder, due)
                await self._remove_archived()
        except StoreUnavailableError:
            # It has an alarm apart.
            return
        except (StoreError, OSError) as error:
            await self._failed(error.message if isinstance(error, StoreError) else system_error(error))
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

    async def _next_due(self) -> _Due | None:
        """The next entries to archive. They end before the first entry of a later month, so that the newest
        ones always stay, and no clock that is ahead archives all."""
        cut = await self._newest_cut()
        now, first, last = self._clock(), None, 0 if cut is None else cut.last
        begin = last + 1
        ends: list[tuple[str, UnixTime]] = []
        while times := await self._database.read(partial(cuts.times_after, number=last)):
            for number, time in times:
                if not is_known(time, now):
                    continue
                if first is None:
                    first = number
                    due = months_due(time, now, self._keep, self._zone)
                    ends = [(month.name, month.after(1).begins) for month in due]
                while ends and time >= ends[0][1]:
                    month, _ = ends.pop(0)
                    until = await self._database.read_costly(
                        partial(cuts.before_unfinished, first=begin, last=number - 1)
                    )
                    if until >= begin:
                        return _Due(month, begin, until)
                if not ends:
                    return None
            last = times[-1][0]
        return None

    async def _newest_cut(self) -> Cut | None:
        ring = self._events.keys.ring
        noted = await self._database.read(cuts.cuts_of)
        if noted and not noted[-1].is_sealed(ring):
            raise EventArchiveError(Message.of("audit_archive_forged", file=noted[-1].file))
        return noted[-1] if noted else None

    async def _archive(self, folder: Path, due: _Due) -> None:
        before = await self._newest_cut()
        walk = Walk(self._events.keys.ring, start=before.ends if before else None)
        writer = await in_thread(partial(ArchiveWriter, folder, due.month))
        try:
            first_hash = await self._write(writer, walk, due)
            name, digest = await in_thread(writer.close)
        except BaseException:
            writer.discard()
            raise
        first_hash = before.first_hash if before else first_hash
        heads = heads_text(walk.ends)
        cut = Cut(due.last, due.first, name, digest, first_hash, heads, self._clock())
        sealed = cut.sealed(self._events.keys.ring)
        what = Message.of("event_archived", first=due.first, last=due.last, file=name)
        digest_text = Message.of("event_archived_digest", digest=digest)
        await self._events.record(
            kind="audit", what=what, message=digest_text, also=partial(cuts.add_cut, cut=sealed)
        )

    async def _write(self, writer: ArchiveWriter, walk: Walk, due: _Due) -> str:
        """Write the entries, and return the hash of the first. Raises EventArchiveError where the log was
        altered: it stays as it is, as evidence."""
        number, first_hash = due.first, ""
        while number <= due.last:
            read = partial(cuts.entries_between, first=number, last=due.last, limit=CHUNK)
            chunk = await self._database.read(read)
            bare = [{name: value for name, value in each.items() if name != "part_of"} for each in chunk]
            await in_thread(partial(walk.follow, bare))
            if not chunk or walk.fault is not None:
                altered = walk.fault or Message("audit_altered_after_anchor")
                raise EventArchiveError(Message.of("audit_archive_of_altered", reason=altered))
            first_hash = first_hash or chunk[0]["hash"]
            await in_thread(partial(writer.write, chunk))
            number = chunk[-1]["id"] + 1
        return first_hash

    async def _remove_archived(self) -> None:
        """Remove what is archived, in transactions between which others write."""
        if await self._newest_cut() is None:
            return
        while await self._database.write(cuts.remove_some):
            continue
