"""The anchor: a file outside the store that names the newest entry of the audit log, every minute.

A configured anchor is only ever appended to, a line of JSON each time, so that it may be append-only or on
write-once media. Without one only the newest line is kept, in a file beside the key. A line of 0.2 may name
the ends of several ``chains``.

``{"id":812,"hash":"3fa9…","time":"2026-11-21T02:01:33Z","key":"91c2…","seal":"77ab…"}``
"""

from __future__ import annotations

import asyncio
import errno
import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import structlog

from app.core.database.files import restrict, write_file
from app.core.lifespan import in_thread
from app.core.web.formats import Formats
from app.errors import StoreError, system_error
from app.people.audit.entry import Head, KeyRing, newest_of
from app.people.audit.keys import find_key_file
from app.people.audit.log import EventLog
from app.people.audit.proof import AuditVerification
from app.people.audit.settings import Audit
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, joined

EVERY_S = 60.0
WITHIN_S = 10.0
"""The seconds that the medium has for one line, which may be long on a network."""
AT_END_S = 1.0
"""The seconds that the medium has for the last line while the server ends, which takes five in total."""
_TAIL_BYTES = 65_536
"""The bytes at the end of a file that contain the newest line."""
T = TypeVar("T")
log = structlog.get_logger()


class AnchorError(StoreError):
    """Raised when the anchor cannot be read or written; ``reason``: the cause in a few words."""

    def __init__(self, path: Path, cause: OSError | Message) -> None:
        is_link = isinstance(cause, OSError) and cause.errno == errno.ELOOP
        reason = Message("anchor_is_link") if is_link else cause
        self.reason = reason if isinstance(reason, Message) else system_error(reason)
        super().__init__(Message.of("anchor_failed", path=str(path), reason=self.reason))


@contextmanager
def _in_words(path: Path) -> Iterator[None]:
    """Turn exceptions of the file system into an AnchorError."""
    try:
        yield
    except OSError as error:
        raise AnchorError(path, error) from error


class _AnchorLine(msgspec.Struct, omit_defaults=True):
    id: int
    hash: str
    time: str
    key: str
    seal: str = ""
    chains: dict[str, tuple[int, str]] = {}

    @property
    def sealed_parts(self) -> tuple[str, ...]:
        chains = [msgspec.json.encode(self.chains).decode()] if self.chains else []
        return str(self.id), self.hash, self.time, *chains

    def is_sealed(self, ring: KeyRing) -> bool:
        return ring.confirms(self.seal, self.key, "anchor", *self.sealed_parts)


@dataclass(frozen=True)
class Anchors:
    """The content of an anchor. ``hashes``: by entry; ``forged``: the number of the first line that was not
    written with the key; ``unreadable``: how many lines are invalid, such as one cut off by a power
    failure."""

    hashes: dict[int, str] = field(default_factory=dict)
    forged: int | None = None
    unreadable: int = 0


def anchor_file(settings: Audit, key_files: Sequence[Path]) -> Path:
    """Return the file of the anchor: as configured, or beside the key, which is the first of ``key_files``
    that exists."""
    key_file = find_key_file(key_files) or key_files[0]
    return settings.anchor or key_file.with_name(f"{key_file.name}.anchor")


def anchor_line(head: Head, at: UnixTime, ring: KeyRing) -> bytes:
    """Return the line that names ``head`` as the newest entry at an instant."""
    time_text = datetime.fromtimestamp(float(at), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = _AnchorLine(head.id, head.hash, time_text, ring.newest)
    line.seal = ring.seal("anchor", *line.sealed_parts)
    return msgspec.json.encode(line) + b"\n"


def read_anchors(lines: Iterable[bytes], ring: KeyRing) -> Anchors:
    """Read lines of an anchor. A line with another hash of an entry than an earlier one counts as forged."""
    hashes: dict[int, str] = {}
    unreadable = 0
    for number, text in enumerate(lines, start=1):
        if not text.strip():
            continue
        line = _decoded(text)
        if line is None:
            unreadable += 1
            continue
        named = [*line.chains.values()] or [(line.id, line.hash)]
        if not line.is_sealed(ring) or any(hashes.setdefault(*each) != each[1] for each in named):
            return Anchors(hashes, number, unreadable)
    return Anchors(hashes, None, unreadable)


def _decoded(text: bytes) -> _AnchorLine | None:
    try:
        return msgspec.json.decode(text, type=_AnchorLine)
    except (msgspec.MsgspecError, UnicodeError):
        return None


def read_anchor_file(path: Path, ring: KeyRing) -> Anchors:
    """Read an anchor. Raise AnchorError, and StoreError for a line that was not written with the key."""
    with _in_words(path), path.open("rb") as file:
        anchors = read_anchors(file, ring)
    if anchors.forged is not None:
        raise StoreError(Message.of("anchor_line_forged", line=anchors.forged, path=str(path)))
    return anchors


def newest_anchor(path: Path, ring: KeyRing) -> Head:
    """Return the last entry that a file names, number 0 if there is none; make the file readable by its user
    alone. Raise AnchorError."""
    with suppress(OSError, StoreError):
        restrict(path)
    lines = (line for line in _newest_lines(path) if line.is_sealed(ring))
    newest = next(lines, None)
    return Head() if newest is None else Head(newest.id, newest.hash)


def is_of_lost_key(path: Path, ring: KeyRing) -> bool:
    """Return whether the newest line of a file was written with a key that is not in the ring. Raise
    AnchorError."""
    newest = next(_newest_lines(path), None)
    return newest is not None and ring.rank(newest.key) is None


def put_aside(path: Path) -> Path | None:
    """Rename an anchor, which stays as evidence; return its new path, None without a file. Raise
    AnchorError."""
    aside = path.with_name(f"{path.name}.until-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}")
    with _in_words(path), suppress(FileNotFoundError):
        path.rename(aside)
        return aside
    return None


def _newest_lines(path: Path) -> Iterator[_AnchorLine]:
    """Yield the readable lines at the end of a file, the newest first."""
    with _in_words(path), suppress(FileNotFoundError), path.open("rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - _TAIL_BYTES))
        decoded = [_decoded(text) for text in file.read().splitlines()]
        yield from (line for line in reversed(decoded) if line is not None)


def append_line(path: Path, line: bytes) -> None:
    """Append a line to a file, which is made if necessary; it is on disk when this returns. Raise
    AnchorError."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    with _in_words(path), os.fdopen(os.open(path, flags, 0o600), "r+b", buffering=0) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise AnchorError(path, Message("anchor_no_file"))
        # The remains of a power failure must not take the new line with them.
        cut_off = found.st_size > 0 and os.pread(file.fileno(), 1, found.st_size - 1) != b"\n"
        data = b"\n" + line if cut_off else line
        while data:
            data = data[file.write(data) :]
        os.fsync(file.fileno())


@dataclass(frozen=True, slots=True)
class AnchorStatus:
    """The state of the anchor. ``altered``: how the log differs from it, until the server restarts;
    ``unwritten``: why the anchor is behind, ``since`` when (Unix time in seconds). Both are mostly None."""

    altered: Message | None = None
    unwritten: Message | None = None
    since: UnixTime = UnixTime(0.0)


class Anchoring:
    """The writer of the anchor: it names the newest entry of ``events`` in the file ``path`` once it is
    stored: the log may be ahead of the anchor, never behind. It never raises for a fault of the medium. If
    not ``is_configured``, the file is the one beside the key: a failed write is then only an event, and with
    a new key the file begins again."""

    def __init__(
        self, events: EventLog, path: Path, clock: Clock = unix_now, *, is_configured: bool = True
    ) -> None:
        self.status = AnchorStatus()
        self.compared_at: UnixTime | None = None
        """The time when the file was last found to name the newest entry."""
        self._events = events
        self._path = path
        self._clock = clock
        self._is_configured = is_configured
        self._anchored: Head | None = None
        """The entry that the file names; None before it was read."""
        self._is_failing = False
        self._work: asyncio.Future[Any] | None = None
        self._one_at_a_time = asyncio.Lock()

    async def follow(self) -> None:
        """Write the anchor every minute, until canceled."""
        while True:
            await self.export()
            await asyncio.sleep(EVERY_S)

    async def end(self) -> None:
        """Export once more as the server ends, if the medium is quick."""
        with suppress(TimeoutError):
            async with asyncio.timeout(AT_END_S):
                await self.export(AT_END_S)

    async def verify(self) -> AuditVerification:
        """Verify the complete log, and that it holds the entry that the anchor names."""
        named = self._anchored
        return await self._events.proof.verify({named.id: named.hash} if named and named.id else {})

    async def export(self, within_s: float = WITHIN_S) -> None:
        """Write the newest entry into the anchor if it has changed. A failure is an event and a
        :attr:`status`, and is retried."""
        async with self._one_at_a_time:
            try:
                if await self._export(within_s):
                    self.compared_at = self._clock()
            except AnchorError as error:
                await self._failed(error.reason)
            except StoreError as error:
                log.error("audit log not anchored", why=str(error))

    async def _export(self, within_s: float) -> bool:
        """Return whether the file names the newest entry."""
        if self.status.altered:
            return False
        known, ring = self._anchored, self._events.keys.ring
        if known is None:
            known = await self._in_thread(lambda: self._present(ring), within_s)
        newest = newest_of((await self._events.proof.heads()).values())
        is_noted = (newest.id, newest.hash) == (known.id, known.hash)
        if is_noted and self._anchored is not None:
            return True
        proof = await self._events.proof.since(known)
        self._anchored = known
        if proof.fault is not None:
            await self._found_altered(proof.fault)
            return False
        if is_noted:
            return True
        line = anchor_line(newest, self._clock(), self._events.keys.ring)
        await self._in_thread(lambda: self._write(line), within_s)
        self._anchored = newest
        if self._is_failing:
            self._is_failing = False
            self.status = AnchorStatus(self.status.altered)
            await self._record(Message("event_anchor_written"))
        return True

    def _present(self, ring: KeyRing) -> Head:
        if not self._is_configured and is_of_lost_key(self._path, ring):
            put_aside(self._path)
        return newest_anchor(self._path, ring)

    def _write(self, line: bytes) -> None:
        if self._is_configured:
            append_line(self._path, line)
        else:
            with _in_words(self._path):
                write_file(self._path, line)

    async def _in_thread(self, work: Callable[[], T], within_s: float) -> T:
        """Run ``work`` once earlier work has ended, because a network file system may hang. Raise
        AnchorError after ``within_s``."""
        try:
            async with asyncio.timeout(within_s):
                if self._work is not None:
                    await asyncio.wait([self._work])
                self._work = started = asyncio.ensure_future(in_thread(work))
                return await asyncio.shield(started)
        except TimeoutError as error:
            raise AnchorError(self._path, Message("anchor_no_response")) from error

    async def _found_altered(self, fault: Message) -> None:
        self.status = AnchorStatus(fault, self.status.unwritten, self.status.since)
        log.error("audit log altered", why=str(fault))
        verify = Message("audit_verify_names_entry")
        await self._record(Message("event_audit_altered"), joined([fault, verify]) or verify)

    async def _failed(self, reason: Message) -> None:
        if self._is_failing:
            return
        self._is_failing = True
        if self._is_configured:
            self.status = AnchorStatus(self.status.altered, reason, self._clock())
        log.error("audit anchor not written", path=str(self._path), why=str(reason))
        await self._record(Message("event_anchor_not_written"), reason)

    async def _record(self, what: Message, message: Message | str = "") -> None:
        with suppress(StoreError):
            await self._events.record(kind="audit", what=what, message=message)


def anchor_notice(status: AnchorStatus, formats: Formats, now: UnixTime) -> Message | None:
    """Return the notice about a log that was altered or an anchor that is behind; mostly None."""
    if status.altered is not None:
        return Message("audit_altered_after_anchor")
    if status.unwritten is not None:
        since = formats.since(status.since, now)
        return Message.of("audit_anchor_missed", time=since, reason=status.unwritten)
    return None
