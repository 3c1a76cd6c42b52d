"""Still pictures of the format WebP as one that moves (RFC 9649)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

PICTURE_CHUNKS = (b"ALPH", b"VP8 ", b"VP8L")
HAS_ANIMATION, REPLACES = 0x02, 0x02
"""Flags of the file, and of a frame that is not blended with the one before."""


def animated(stills: Sequence[bytes], size: tuple[int, int], each_ms: int) -> bytes:
    """Pictures of one size, shown in turn for ever."""
    width, height = (_number(edge - 1) for edge in size)
    start = _chunk(b"VP8X", bytes([HAS_ANIMATION, 0, 0, 0]) + width + height)
    endless = _chunk(b"ANIM", struct.pack("<IH", 0, 0))
    place = _number(0) + _number(0) + width + height + _number(each_ms) + bytes([REPLACES])
    frames = (
        _chunk(
            b"ANMF",
            place + b"".join(_chunk(name, data) for name, data in chunks(still) if name in PICTURE_CHUNKS),
        )
        for still in stills
    )
    return _chunk(b"RIFF", b"WEBP" + start + endless + b"".join(frames))


def chunks(file: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Name and content of each part of a file. Raises ValueError for one that is no WebP."""
    if file[:4] != b"RIFF" or file[8:12] != b"WEBP":
        raise ValueError("It is no WebP.")
    place = 12
    while place < len(file):
        name, size = struct.unpack_from("<4sI", file, place)
        yield name, file[place + 8 : place + 8 + size]
        place += 8 + size + size % 2


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)


def _number(value: int) -> bytes:
    return value.to_bytes(3, "little")
