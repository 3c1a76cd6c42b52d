"""Rows in the form that is the same on every engine, and the digest of many. Pure."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from app.database.copying.tables import StoreTable

CopiedRow = tuple[Any, ...]
Key = tuple[Any, ...]
MAX_ROWS = 4096
MAX_BYTES = 2**22
"""Of one chunk."""
FIRST_ROWS = 16
"""A picture has at most a megabyte."""
_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(tuple)


def packed(values: CopiedRow) -> bytes:
    """Integers, floats, texts, bytes and NULL by MessagePack: values that differ, differ."""
    return _encoder.encode(values)


def packed_key(key: Key | None) -> str:
    """A position as a text; empty: before the first row."""
    return "" if key is None else packed(key).hex()


def unpacked_key(text: str) -> Key | None:
    return _decoder.decode(bytes.fromhex(text)) if text else None


@dataclass(frozen=True, slots=True)
class Chunk:
    """Neighbouring rows of a table, in the order of their keys, and each as it is compared."""

    rows: dict[Key, CopiedRow]
    forms: dict[Key, bytes]

    @property
    def size(self) -> int:
        return sum(map(len, self.forms.values()))

    def until(self, last: Key | None) -> Chunk:
        """The rows up to a key; None: all."""
        if last is None or not self.rows or next(reversed(self.rows)) <= last:
            return self
        kept = [key for key in self.rows if key <= last]
        return Chunk({key: self.rows[key] for key in kept}, {key: self.forms[key] for key in kept})

    def only(self, keys: Mapping[Key, object]) -> Chunk:
        """The rows whose keys are among these."""
        kept = [key for key in self.rows if key in keys]
        return Chunk({key: self.rows[key] for key in kept}, {key: self.forms[key] for key in kept})


def chunk_of(table: StoreTable, rows: Iterable[CopiedRow]) -> Chunk:
    places = table.places
    by_key = {tuple([row[place] for place in places]): row for row in rows}
    return Chunk(by_key, {key: _encoder.encode(row) for key, row in by_key.items()})


def common_end(*chunks: tuple[Chunk, int]) -> Key | None:
    """Up to which key chunks are complete, each read with a limit: the lowest end of those that reached it.
    None: all of them are complete to the end of the table."""
    ends: list[Key] = [next(reversed(chunk.rows)) for chunk, limit in chunks if len(chunk.rows) >= limit]
    return min(ends) if ends else None


def next_limit(limit: int, chunk: Chunk) -> int:
    """How many rows to read next, by the size of the last ones."""
    if not chunk.rows:
        return limit
    mean = chunk.size // len(chunk.rows) + 1
    return max(1, min(4 * limit, MAX_ROWS, MAX_BYTES // mean))


@dataclass(frozen=True, slots=True)
class Tally:
    """What was read of a table on one side. ``digest``: SHA-256 of the digest before and the next row, row by
    row, in hexadecimal digits; empty: of no row."""

    rows: int = 0
    size: int = 0
    digest: str = ""

    def with_rows(self, forms: Sequence[bytes]) -> Tally:
        digest, sha256 = bytes.fromhex(self.digest), hashlib.sha256
        for form in forms:
            digest = sha256(digest + form).digest()
        return Tally(self.rows + len(forms), self.size + sum(map(len, forms)), digest.hex())
