"""The keys in use, read from their file again when the log shows one that is newer."""

from __future__ import annotations

import os
import secrets
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from app.audit.chain import Head
from app.audit.key_file import KeyFileError, make_key_file, read_key_file, replace_key_file
from app.audit.keyring import KEY_BYTES, KeyOrigin, KeyRing
from bus.messages import Message


class Keys:
    """One for the app. Without a ``path`` the keys end with the process."""

    def __init__(self, ring: KeyRing, path: Path | None = None, owners: frozenset[int] = frozenset()) -> None:
        self.ring = ring
        self.path = path
        self._owners = owners

    def knowing(self, key_id: str) -> KeyRing:
        """The ring, with the key of this id if the file has it: another process may have rotated the keys.

        Raises KeyFileError when the file cannot be used any more.
        """
        if key_id and self.ring.rank(key_id) is None and self.path is not None:
            self.ring = read_key_file(self.path, self._owners) or self.ring
        return self.ring

    def rotate(self) -> None:
        """Make a newer key, which seals new entries; the others still verify the entries they sealed.

        Raises KeyFileError.
        """
        ring = self.ring.with_key(secrets.token_bytes(KEY_BYTES))
        if self.path is not None:
            replace_key_file(self.path, ring)
        self.ring = ring


def passing_keys() -> Keys:
    """Keys that nothing outlives."""
    return Keys(KeyRing((secrets.token_bytes(KEY_BYTES),)))


def open_keys(paths: Sequence[Path], store: Path, head: Head) -> Keys:
    """The keys of the log in ``store``, whose newest entry is ``head``, from the first of the files that is
    there. Where none is, the first that can be made is made. Raises KeyFileError."""
    owners = owners_of(store)
    path = find_key_file(paths) or _made(paths, KeyOrigin(head.id, head.hash))
    ring = read_key_file(path, owners)
    if ring is None:
        raise KeyFileError(Message.of("audit_key_removed", path=str(path)))
    return Keys(ring, path, owners)


def find_key_file(paths: Sequence[Path]) -> Path | None:
    """The first of the files that there is; a link to nowhere is one, which is refused when it is read."""
    return next((path for path in paths if os.path.lexists(path)), None)


def owners_of(store: Path) -> frozenset[int]:
    """The users to whom the key of a store may belong: ours, root, and the one whose store it is."""
    return frozenset({os.geteuid(), 0, store.stat().st_uid})


def _made(paths: Sequence[Path], origin: KeyOrigin) -> Path:
    *others, last = paths
    for path in others:
        with suppress(KeyFileError):
            make_key_file(path, origin)
            return path
    make_key_file(last, origin)
    return last
