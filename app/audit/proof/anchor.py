"""The anchor: heads of the audit log in a file that cannot be changed with access to the store alone.

One line of JSON for the newest entry of the log, only ever appended: the file may be append-only or on
write-once media. ``chains`` of a line are the heads that differ from those of the lines before, at the same
instant; a line without them is of the site's chain. The anchor beside the key has the newest head of every
chain in one line: that a log began, and how far it came.

``{"id":812,"hash":"3fa9…","time":"2026-11-21T02:01:33Z","key":"91c2…","seal":"77ab…"}``
``{"id":815,"hash":"0b1e…",…,"chains":{"dry-end":[815,"0b1e…"]}}``
"""

from __future__ import annotations

import errno
import os
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from app.audit.proof.chain import SITE, Head, newest_of
from app.audit.proof.keyring import KeyRing
from app.database.private import restrict, write_file
from app.errors import StoreError, system_error
from bus.instants import UnixTime
from bus.messages import Message

FULL_EVERY_BYTES = 131_072
"""At least so often a line of a file has the heads of all chains."""
_TAIL_BYTES = 2 * FULL_EVERY_BYTES
"""Where the newest head of each chain is, however long the file is."""


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


class _AnchorLine(msgspec.Struct, omit_defaults=True):
    id: int
    hash: str
    time: str
    key: str
    seal: str = ""
    chains: dict[str, tuple[int, str]] = {}

    @property
    def heads(self) -> dict[str, Head]:
        """The heads that it names, by chain."""
        chains = self.chains or {SITE: (self.id, self.hash)}
        return {name: Head(*end, chain=name) for name, end in chains.items()}

    @property
    def sealed_parts(self) -> tuple[str, ...]:
        chains = [msgspec.json.encode(self.chains).decode()] if self.chains else []
        return str(self.id), self.hash, self.time, *chains

    def is_sealed(self, ring: KeyRing) -> bool:
        return ring.confirms(self.seal, self.key, "anchor", *self.sealed_parts)


@dataclass(frozen=True)
class Anchors:
    """The content of a file of anchors. ``heads``: by entry. ``forged``: the first line that was not
    written with the key; ``unreadable``: invalid lines, as one that a power failure cut off."""

    heads: dict[int, Head] = field(default_factory=dict)
    newest: int = 0
    forged: int | None = None
    unreadable: int = 0


def anchor_line(heads: Mapping[str, Head], at: UnixTime, ring: KeyRing) -> bytes:
    """Heads of one instant, by chain, as a line of the file. ``at``: Unix time in seconds."""
    newest = newest_of(heads.values())
    time = datetime.fromtimestamp(float(at), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = _AnchorLine(newest.id, newest.hash, time, ring.newest)
    if heads.keys() != {SITE}:
        line.chains = {name: (head.id, head.hash) for name, head in sorted(heads.items())}
    line.seal = ring.seal("anchor", *line.sealed_parts)
    return msgspec.json.encode(line) + b"\n"


def read_anchors(lines: Iterable[bytes], ring: KeyRing) -> Anchors:
    """The content of the lines. Of two different hashes of one entry the second counts as forged."""
    heads: dict[int, Head] = {}
    newest = unreadable = 0
    for number, text in enumerate(lines, start=1):
        if not text.strip():
            continue
        line = _decoded(text)
        if line is None:
            unreadable += 1
            continue
        named = line.heads.values()
        if not line.is_sealed(ring) or any(
            heads.setdefault(head.id, head).hash != head.hash for head in named
        ):
            return Anchors(heads, newest, forged=number, unreadable=unreadable)
        newest = line.id
    return Anchors(heads, newest, unreadable=unreadable)


def _decoded(text: bytes) -> _AnchorLine | None:
    try:
        return msgspec.json.decode(text, type=_AnchorLine)
    except (msgspec.MsgspecError, UnicodeError):
        return None


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


def joined_heads(first: Anchors, second: Anchors) -> dict[int, Head]:
    """The heads of two files by entry. Where they contradict each other no hash will do."""
    both = {
        number: replace(head, hash="")
        for number, head in first.heads.items()
        if second.heads.get(number, head).hash != head.hash
    }
    return first.heads | second.heads | both


def read_anchor_file(path: Path, ring: KeyRing) -> Anchors:
    """Read the anchors of a file. Raises AnchorError."""
    with _in_words(path), path.open("rb") as file:
        return read_anchors(file, ring)


def newest_anchor(path: Path, ring: KeyRing) -> dict[str, Head]:
    """The head that a file names last of each chain; empty where there is no file yet, or none in it; the
    file becomes readable by its user alone. Raises AnchorError."""
    with suppress(OSError, StoreError):
        restrict(path)
    heads: dict[str, Head] = {}
    for text in _newest_lines(path):
        line = _decoded(text)
        if line is not None and line.is_sealed(ring):
            heads |= line.heads
    return heads


def is_of_lost_key(path: Path, ring: KeyRing) -> bool:
    """Whether the newest line of a file names a key that is not in the ring: it cannot be checked any more.
    Raises AnchorError."""
    lines = (_decoded(text) for text in reversed(_newest_lines(path)))
    newest = next((line for line in lines if line is not None), None)
    return newest is not None and ring.rank(newest.key) is None


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
        return file.read().splitlines()
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
