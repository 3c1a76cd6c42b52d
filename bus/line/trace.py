"""The last frames of a line, at most an hour of them, packed; their meaning is computed on demand."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from bus.contract import MAX_FRAME, MAX_MEANINGS, Direction, Frame
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.describe import Describer
from bus.wire.framing import FrameDecoder

MAX_AGE_S = 3600.0
MAX_BYTES = 16_000_000
PIECE_BYTES = 65_536
MAX_FRAMES_OF_A_COMMAND = 300
HIDDEN = Message("frame_secret")

_HEAD = struct.Struct("<dBBH")
_VALID, _HIDDEN = 1, 2


class TracedFrame(NamedTuple):
    """A frame or piece of noise as it passed the port; ``at``: seconds since the epoch."""

    at: UnixTime
    direction: Direction
    data: bytes
    valid: bool = True
    hidden: bool = False


@dataclass(slots=True)
class _Piece:
    began: UnixTime
    packed: bytearray


class Trace:
    """A ring of packed frames, bounded by time and by bytes."""

    def __init__(self, kept_s: float = MAX_AGE_S, kept_bytes: int = MAX_BYTES) -> None:
        self._kept_s = kept_s
        self._kept_bytes = kept_bytes
        self._pieces: deque[_Piece] = deque()
        self.follower: Callable[[TracedFrame], None] | None = None
        """Called with each frame as it passes, while the trace is followed."""
        self.witness: list[TracedFrame] | None = None
        """The list that receives the frames of the command under way as well; None if there is none."""

    def add(self, passed: TracedFrame) -> None:
        """Keep one frame: without its bytes if it is secret, and only the beginning of endless noise."""
        data = b"" if passed.hidden else passed.data[:MAX_FRAME]
        if not self._pieces or len(self._pieces[-1].packed) >= PIECE_BYTES:
            self._pieces.append(_Piece(passed.at, bytearray()))
            self._drop_old(passed.at)
        flags = passed.valid * _VALID | passed.hidden * _HIDDEN
        packed = self._pieces[-1].packed
        packed += _HEAD.pack(passed.at, passed.direction == "in", flags, len(data))
        packed += data
        if self.witness is not None and len(self.witness) < MAX_FRAMES_OF_A_COMMAND:
            self.witness.append(passed._replace(data=data))
        if self.follower is not None:
            self.follower(passed._replace(data=data))

    def since(self, at: UnixTime) -> Iterator[TracedFrame]:
        """Yield the kept frames from ``at`` on, oldest first. New frames may come while they are read."""
        pieces = list(self._pieces)
        for place, piece in enumerate(pieces):
            if place + 1 == len(pieces) or pieces[place + 1].began > at:
                yield from (passed for passed in _unpack(bytes(piece.packed)) if passed.at >= at)

    @property
    def size(self) -> int:
        """The number of bytes that the trace uses."""
        return sum(len(piece.packed) for piece in self._pieces)

    def _drop_old(self, now: UnixTime) -> None:
        while len(self._pieces) > 1 and (
            self._pieces[1].began < now - self._kept_s or self.size > self._kept_bytes
        ):
            self._pieces.popleft()


def _unpack(packed: bytes) -> Iterator[TracedFrame]:
    place = 0
    while place < len(packed):
        at, came_in, flags, length = _HEAD.unpack_from(packed, place)
        place += _HEAD.size
        data = packed[place : place + length]
        place += length
        yield TracedFrame(at, "in" if came_in else "out", data, bool(flags & _VALID), bool(flags & _HIDDEN))


class Interpreter:
    """The interpreter of frames. Give it frames in their order: a response is read in the context of its
    request."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._describer = Describer(dialect)

    def frame(self, passed: TracedFrame) -> Frame:
        if passed.hidden:
            return Frame(passed.at, passed.direction, b"", [HIDDEN], passed.valid)
        decoder = FrameDecoder(self._dialect)
        described = self._describer.describe([*decoder.feed(passed.data), *decoder.flush()])
        meanings = [each.meaning for each in described[:MAX_MEANINGS]]
        return Frame(passed.at, passed.direction, passed.data, meanings, passed.valid)
