"""The anchor: heads of the audit log in a file that cannot be changed with access to the store alone.

One line of JSON for each head, only ever appended: the file may be append-only or on write-once media. The
anchor beside the key has the newest line alone: that a log began, and how far it came.

``{"id":812,"hash":"3fa9…","time":"2026-11-21T02:01:33Z","key":"91c2…","seal":"77ab…"}``
"""

from __future__ import annotations

import errno
import os
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from app.audit.chain import Head
from app.audit.keyring import KeyRing
from app.database.private import restrict, write_file
from app.errors import StoreError, system_error
from bus.instants import UnixTime
from bus.messages import Message

_TAIL_BYTES, _TAIL_LINES = 4096, 5
"""Where the newest line of a file is, however long that is."""


class AnchorError(StoreError):
    """The anchor cannot be read or written; ``reason`` in short."""

    def __init__(self, path: Path, cause: OSError | Message) -> None:
        is_link = isinstance(cause, OSError) and cause.errno == errno.ELOOP
        reason = Message("anchor_is_link") if is_link else cause
        self.reason = reason if isinstance(reason, Message) else system_error(reason)
        super().__init__(Message.of("anchor_failed", path=str(path), reason=self.reason))


@contextmanager
def _in_words(path: Path) -> Iterator[None]:
    """Turn what the file system raises into an AnchorError."""
    try:
        yield
    except OSError as error:
        raise AnchorError(path, error) from error


class _AnchorLine(msgspec.Struct):
    id: int
    hash: str
    time: str
    key: str
    seal: str


@dataclass(frozen=True)
class Anchors:
    """The content of a file of anchors. ``heads``: hash by entry. ``forged``: the first line that was not
    written with the key; ``unreadable``: invalid lines, as one that a power failure cut off."""

    heads: dict[int, str] = field(default_factory=dict)
    newest: int = 0
    forged: int | None = None
    unreadable: int = 0


def anchor_line(head: Head, at: UnixTime, ring: KeyRing) -> bytes:
    """A head as a line of the file. ``at``: Unix time in seconds."""
    time = datetime.fromtimestamp(float(at), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    seal = ring.seal("anchor", str(head.id), head.hash, time)
    return msgspec.json.encode(_AnchorLine(head.id, head.hash, time, ring.newest, seal)) + b"\n"


def read_anchors(lines: Iterable[bytes], ring: KeyRing) -> Anchors:
    """The content of the lines. Of two different hashes of one entry the second counts as forged."""
    heads: dict[int, str] = {}
    newest = unreadable = 0
    for number, text in enumerate(lines, start=1):
        if not text.strip():
            continue
        try:
            line = msgspec.json.decode(text, type=_AnchorLine)
        except (msgspec.MsgspecError, UnicodeError):
            unreadable += 1
            continue
        sealed = ring.confirms(line.seal, line.key, "anchor", str(line.id), line.hash, line.time)
        if not sealed or heads.setdefault(line.id, line.hash) != line.hash:
            return Anchors(heads, newest, forged=number, unreadable=unreadable)
        newest = line.id
    return Anchors(heads, newest, unreadable=unreadable)


def key_anchor_of(key_file: Path) -> Path:
    """The anchor beside a key file."""
    return key_file.with_name(f"{key_file.name}.anchor")


def read_key_anchor(key_file: Path | None, ring: KeyRing) -> Anchors:
    """The content of the anchor beside a key file; none where there is no file yet. Raises AnchorError, and
    StoreError for a line that was not written with the key."""
    path = None if key_file is None else key_anchor_of(key_file)
    if path is None or not path.exists():
        return Anchors()
    return refuse_forged(path, read_anchor_file(path, ring))


def refuse_forged(path: Path, anchors: Anchors) -> Anchors:
    """Return ``anchors``. Raises StoreError for a line that was not written with the key."""
    if anchors.forged is not None:
        raise StoreError(Message.of("anchor_line_forged", line=anchors.forged, path=str(path)))
    return anchors


def joined_heads(first: Anchors, second: Anchors) -> dict[int, str]:
    """The hashes of two files by entry. Where they contradict each other no hash will do."""
    both = {number: "" for number, head in first.heads.items() if second.heads.get(number, head) != head}
    return first.heads | second.heads | both


def read_anchor_file(path: Path, ring: KeyRing) -> Anchors:
    """Read the anchors of a file. Raises AnchorError."""
    with _in_words(path), path.open("rb") as file:
        return read_anchors(file, ring)


def newest_anchor(path: Path, ring: KeyRing) -> Head | None:
    """The head that a file names last, None where there is no file yet, or none in it; the file becomes
    readable by its user alone. Raises AnchorError."""
    with suppress(OSError, StoreError):
        restrict(path)
    anchors = read_anchors(_newest_lines(path), ring)
    return Head(anchors.newest, anchors.heads[anchors.newest]) if anchors.newest else None


def is_of_lost_key(path: Path, ring: KeyRing) -> bool:
    """Whether the newest line of a file names a key that is not in the ring: it cannot be checked any more.
    Raises AnchorError."""
    for text in reversed(_newest_lines(path)):
        with suppress(msgspec.MsgspecError, UnicodeError):
            return ring.rank(msgspec.json.decode(text, type=_AnchorLine).key) is None
    return False


def put_aside(path: Path) -> Path | None:
    """Rename a file of anchors, which stays as evidence; return its new name, None where there is no file.
    Raises AnchorError."""
    aside = path.with_name(f"{path.name}.until-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}")
    with _in_words(path), suppress(FileNotFoundError):
        path.rename(aside)
        return aside
    return None


def _newest_lines(path: Path) -> list[bytes]:
    with _in_words(path), suppress(FileNotFoundError), path.open("rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - _TAIL_BYTES))
        return file.read().splitlines()[-_TAIL_LINES:]
    return []


def replace_line(path: Path, line: bytes) -> None:
    """Make ``line`` the only one of the file, all of it or nothing; on disk when this returns. Raises
    AnchorError."""
    with _in_words(path):
        write_file(path, line)


def append_line(path: Path, line: bytes) -> None:
    """Add a line to the file, made where there is none; on disk when this returns. Raises AnchorError."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    with _in_words(path):
        descriptor = os.open(path, flags, 0o600)
        try:
            _append(path, descriptor, line)
        finally:
            os.close(descriptor)


def _append(path: Path, descriptor: int, line: bytes) -> None:
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        raise AnchorError(path, Message("anchor_no_file"))
    # What a power failure cut off must not take the new line with it.
    cut_off = found.st_size > 0 and os.pread(descriptor, 1, found.st_size - 1) != b"\n"
    data = b"\n" + line if cut_off else line
    while data:
        data = data[os.write(descriptor, data) :]
    os.fsync(descriptor)
