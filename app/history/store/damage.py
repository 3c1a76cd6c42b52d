"""Detects damaged blocks by zlib's checksum, so that a damaged block costs only itself."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar

T = TypeVar("T")
StoredTier = Literal["raw", "minutes", "hours"]


@dataclass(frozen=True, slots=True, order=True)
class BlockKey:
    """Where a block is: ``unit`` by its key, ``start`` in µs."""

    tier: StoredTier
    unit: int
    start: int


class DamagedBlock(ValueError):
    """Its content is not what was written."""

    def __init__(self, block: BlockKey, why: str) -> None:
        super().__init__(f"{why} ({block.tier} of unit key {block.unit} from {block.start})")
        self.block = block


def intact(block: BlockKey, unpack: Callable[[], T]) -> T:
    """Return what ``unpack`` gives. Raises DamagedBlock where it raises ValueError."""
    try:
        return unpack()
    except ValueError as error:
        raise DamagedBlock(block, str(error)) from error


def sound(blob: bytes) -> bool:
    """Whether a block still has its checksum."""
    try:
        zlib.decompress(blob)
    except zlib.error:
        return False
    return True
