"""The keys that seal the audit log, and their file: outside the data folder, readable by the server's user
alone.

The file is read again when the log names a key that is newer than those in memory.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import msgspec

from app.core.database.files import fresh_file, sync_folder
from app.errors import StoreError, system_error
from app.people.audit.entry import KEY_BYTES, Ends, KeyOrigin, KeyRing, origin_of
from bus.messages import Message


class Keys:
    """The keys of a log, in a file or, without a ``path``, only in this process."""

    def __init__(self, ring: KeyRing, path: Path | None = None, owners: frozenset[int] = frozenset()) -> None:
        self.ring = ring
        self.path = path
        self._owners = owners

    def knowing(self, key_id: str) -> KeyRing:
        """Return the ring, with the key of this id if the file has it: another process may have rotated the
        keys. Raise KeyFileError if the file cannot be used any more."""
        if key_id and self.ring.rank(key_id) is None and self.path is not None:
            self.ring = read_key_file(self.path, self._owners) or self.ring
        return self.ring

    def rotate(self) -> None:
        """Make a new key, which seals new entries; the others verify the entries that they sealed. Raise
        KeyFileError."""
        ring = self.ring.with_key(secrets.token_bytes(KEY_BYTES))
        if self.path is not None:
            replace_key_file(self.path, ring)
        self.ring = ring


def passing_keys() -> Keys:
    """Return keys that end with the process."""
    return Keys(KeyRing((secrets.token_bytes(KEY_BYTES),)))


def open_keys(paths: Sequence[Path], store: Path | None, heads: Ends) -> Keys:
    """Return the keys of the log in the file ``store``, which ends with ``heads``, from the first of the
    files that exists. Without any, make the first that can be made. Raise KeyFileError."""
    owners = owners_of(store)
    path = find_key_file(paths) or _made(paths, origin_of(heads))
    ring = read_key_file(path, owners)
    if ring is None:
        raise KeyFileError(Message.of("audit_key_removed", path=str(path)))
    return Keys(ring, path, owners)


def find_key_file(paths: Sequence[Path]) -> Path | None:
    """Return the first of the files that exists. A link to nowhere counts: reading it is refused."""
    return next((path for path in paths if os.path.lexists(path)), None)


def owners_of(store: Path | None) -> frozenset[int]:
    """Return the users to whom the key of a store may belong: this process's, root, and the owner of the
    store."""
    owner = os.geteuid() if store is None else store.stat().st_uid
    return frozenset({os.geteuid(), 0, owner})


def _made(paths: Sequence[Path], origin: KeyOrigin) -> Path:
    *others, last = paths
    for path in others:
        with suppress(KeyFileError):
            make_key_file(path, origin)
            return path
    make_key_file(last, origin)
    return last


_MAX_BYTES = 65_536
_Hex = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class KeyFileError(StoreError):
    """Raised when the key file cannot be used; nothing was written into the log."""


class _Log(msgspec.Struct):
    id: Annotated[int, msgspec.Meta(ge=0)]
    hash: _Hex


class _Content(msgspec.Struct, omit_defaults=True):
    """The content of a key file. ``log``: the newest entry when the first key was made; ``chains``: the last
    entries of other chains."""

    log: _Log
    keys: Annotated[list[_Hex], msgspec.Meta(min_length=1)]
    chains: dict[str, _Log] = {}


def read_key_file(path: Path, owners: frozenset[int]) -> KeyRing | None:
    """Return the keys; None without a file. Raise KeyFileError for a file that others could have read or
    made, and for one without keys. ``owners``: the users to whom it may belong."""
    try:
        # A FIFO or a device would delay the start indefinitely.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    except OSError as error:
        reason = Message("audit_key_is_link") if path.is_symlink() else system_error(error)
        raise KeyFileError(Message.of("audit_key_unreadable", path=str(path), reason=reason)) from error
    with os.fdopen(descriptor, "rb") as file:
        _check_access(path, os.fstat(descriptor), owners)
        return _ring(path, file.read(_MAX_BYTES))


def make_key_file(path: Path, origin: KeyOrigin) -> None:
    """Make the file with a first key, for a log that ends at ``origin``, unless another process has made it.
    Raise KeyFileError."""
    content = _content_of(KeyRing((secrets.token_bytes(KEY_BYTES),), origin))
    try:
        with fresh_file(path, content) as fresh:
            # Unlike a rename this never replaces a key that another process has made and used.
            path.hardlink_to(fresh)
        sync_folder(path.parent)
    except FileExistsError:
        return
    except OSError as error:
        failed = Message.of("audit_key_not_made", path=str(path), error=system_error(error))
        raise KeyFileError(failed) from error


def replace_key_file(path: Path, ring: KeyRing) -> None:
    """Replace the file by one with these keys and the same owner. Raise KeyFileError."""
    try:
        owner = path.stat()
        with fresh_file(path, _content_of(ring)) as fresh:
            if (owner.st_uid, owner.st_gid) != (os.geteuid(), os.getegid()):
                os.chown(fresh, owner.st_uid, owner.st_gid)
            fresh.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        failed = Message.of("audit_key_not_replaced", path=str(path), error=system_error(error))
        raise KeyFileError(failed) from error


def _content_of(ring: KeyRing) -> bytes:
    origin = ring.origin
    chains = {name: _Log(number, digest) for name, number, digest in origin.others}
    content = _Content(_Log(origin.id, origin.hash), [key.hex() for key in ring.keys], chains)
    return msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n"


def _check_access(path: Path, found: os.stat_result, owners: frozenset[int]) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise KeyFileError(Message.of("audit_key_no_file", path=str(path)))
    if found.st_uid not in owners:
        raise KeyFileError(Message.of("audit_key_of_other_user", path=str(path)))
    if found.st_mode & 0o077:
        raise KeyFileError(Message.of("audit_key_open_to_others", path=str(path)))
    folder = path.parent.stat().st_mode
    if folder & stat.S_IWOTH and not folder & stat.S_ISVTX:
        raise KeyFileError(Message.of("audit_key_replaceable", path=str(path), folder=str(path.parent)))


def _ring(path: Path, content: bytes) -> KeyRing:
    try:
        decoded = msgspec.json.decode(content, type=_Content)
    except msgspec.MsgspecError as error:
        raise KeyFileError(Message.of("audit_key_damaged", path=str(path), error=str(error))) from error
    others = tuple((name, end.id, end.hash) for name, end in decoded.chains.items())
    origin = KeyOrigin(decoded.log.id, decoded.log.hash, others)
    return KeyRing(tuple(bytes.fromhex(key) for key in decoded.keys), origin)
