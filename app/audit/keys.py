"""The keys in use, read from their file again when the log shows one that is newer."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from app.audit.chain import Head
from app.audit.key_file import KeyFileError, make_key_file, read_key_file, replace_key_file
from app.audit.keyring import KEY_BYTES, KeyRing, Origin


class Keys:
    """One for the app. Without a ``path`` the keys end with the process."""

    def __init__(self, ring: KeyRing, path: Path | None = None, owners: frozenset[int] = frozenset()) -> None:
        self.ring = ring
        self._path = path
        self._owners = owners

    def knowing(self, key_id: str) -> KeyRing:
        """The ring, with the key of this id if the file has it: another process may have rotated the keys.

        Raises KeyFileError when the file cannot be used any more.
        """
        if key_id and self.ring.rank(key_id) is None and self._path is not None:
            self.ring = read_key_file(self._path, self._owners) or self.ring
        return self.ring

    def rotate(self) -> None:
        """Make a newer key, which seals what is written from now on; the others still prove what they sealed.

        Raises KeyFileError.
        """
        ring = self.ring.with_key(secrets.token_bytes(KEY_BYTES))
        if self._path is not None:
            replace_key_file(self._path, ring)
        self.ring = ring


def passing_keys() -> Keys:
    """Keys that nothing outlives."""
    return Keys(KeyRing((secrets.token_bytes(KEY_BYTES),)))


def open_keys(path: Path, store: Path, head: Head) -> Keys:
    """The keys in the file ``path`` of the log in ``store``, whose newest entry is ``head``; the file is made
    where there is none. Raises KeyFileError."""
    owners = owners_of(store)
    ring = read_key_file(path, owners) or make_key_file(path, Origin(head.id, head.hash))
    ring = ring or read_key_file(path, owners)
    if ring is None:
        raise KeyFileError(f"the audit key {path} was removed while it was read; start again")
    return Keys(ring, path, owners)


def owners_of(store: Path) -> frozenset[int]:
    """The users to whom the key of a store may belong: ours, root, and the one whose store it is."""
    return frozenset({os.geteuid(), 0, store.stat().st_uid})
