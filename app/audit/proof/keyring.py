"""The keys that seal the audit log and what else must not be forged (HMAC-SHA256, FIPS 198-1). Pure."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

KEY_BYTES = 32
"""Length of the hash: RFC 2104, 3 discourages shorter keys, and longer ones add nothing."""
BEGINNING = "0" * 64
"""The hash before the first entry of a log."""

Purpose = Literal["entry", "head", "anchor", "command", "decoy", "local", "cut"]
"""The purpose of a seal. It is part of the sealed data: no seal passes for one of another purpose."""


@dataclass(frozen=True)
class KeyOrigin:
    """The newest entry of the log when its first key was made; entries up to it have no seal of that key.
    ``others``: chain, number and hash of the last entries of the other chains at that moment."""

    id: int = 0
    hash: str = BEGINNING
    others: tuple[tuple[str, int, str], ...] = ()

    @cached_property
    def hashes(self) -> dict[int, str]:
        """The hash of the last entry of each chain, by the number of the entry."""
        return {self.id: self.hash, **{number: digest for _, number, digest in self.others}}


@dataclass(frozen=True)
class KeyRing:
    """Every key that a log was ever sealed with, the newest last; the newest seals new entries."""

    keys: tuple[bytes, ...]
    origin: KeyOrigin = KeyOrigin()

    @cached_property
    def _ranks(self) -> dict[str, int]:
        return {_key_id(key): rank for rank, key in enumerate(self.keys)}

    @cached_property
    def newest(self) -> str:
        """The id of the newest key, 16 hex digits that reveal nothing of the key."""
        return _key_id(self.keys[-1])

    def rank(self, key_id: str) -> int | None:
        """The place of a key in the order of their making, None for one that is not here."""
        return self._ranks.get(key_id)

    def seal(self, purpose: Purpose, *parts: str) -> str:
        """Seal ``parts`` with the newest key; hex. Only the last part may contain a line feed."""
        return _seal(self.keys[-1], purpose, parts)

    def confirms(self, seal: str, key_id: str, purpose: Purpose, *parts: str) -> bool:
        """Whether ``seal`` was made of these parts with the key of this id, in constant time."""
        rank = self.rank(key_id)
        return rank is not None and _equal(seal, _seal(self.keys[rank], purpose, parts))

    def confirms_by_any(self, seal: str, purpose: Purpose, *parts: str) -> bool:
        """Whether ``seal`` was made of these parts with any of the keys, in constant time."""
        return any(_equal(seal, _seal(key, purpose, parts)) for key in self.keys)

    def with_key(self, key: bytes) -> KeyRing:
        """A ring with a newer key beside these."""
        return KeyRing((*self.keys, key), self.origin)


def _key_id(key: bytes) -> str:
    return hashlib.sha256(b"lineside audit key\n" + key).hexdigest()[:16]


def _seal(key: bytes, purpose: Purpose, parts: Iterable[str]) -> str:
    message = "\n".join((purpose, *parts))
    return hmac.digest(key, message.encode("utf-8", "surrogatepass"), "sha256").hex()


def _equal(seal: str, right: str) -> bool:
    return hmac.compare_digest(seal.encode("utf-8", "surrogatepass"), right.encode())
