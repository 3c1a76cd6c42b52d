"""The base of every message between worker and app, and what each of its fields can hold at most.

Bounds are checked where a message is decoded, on both sides: neither a worker nor an app is trusted to keep
to them. NaN and the infinities are outside every range.

The ranges are those of the wire (manual, the command pages): speeds to 99999, four-byte values, one byte for
each of the analog input, outputs, inputs and errors, 40 parameters, addresses 1-255.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from bus.instants import UnixTime

CONTRACT_VERSION = 6
BUFFER_AGE_S = 7 * 86_400.0
"""How old an update may be that a worker kept while the app was away. An older one is refused."""

UnitLinkState = Literal["unknown", "online", "stale", "offline"]
BusLinkState = Literal["open", "closed"]
Outcome = Literal["verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed"]
Stage = Literal["waiting", "sent", "searching", "acknowledged", "proving"]
Direction = Literal["out", "in"]


class TaggedStruct(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True):
    """Base of every message and part of a message: immutable, with its type in the field ``is``."""


MAX_UNITS = 255
MAX_UPDATES = 500
"""In a batch, so that no message takes the app's loop for long."""
MAX_FRAMES = 2_000
MAX_MEANINGS = 30
MAX_REMARKS = 20
MAX_TEXT = 4_000
MAX_MEANING = 1_000
"""Characters that are shown of what a frame means."""
MAX_WORDS = 300
MAX_ID = 200
MAX_FRAME = 1_024

UnitId = Annotated[int, Meta(ge=1, le=255)]
Speed = Annotated[int, Meta(ge=0, le=99_999)]
FourBytes = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
Byte = Annotated[int, Meta(ge=0, le=0xFF)]
ParameterNumber = Annotated[int, Meta(ge=1, le=40)]
UnitScale = Annotated[dict[ParameterNumber, FourBytes | None], Meta(max_length=40)]
"""The parameters that a value was converted and bounded with: number → raw, None where the unit lacks it."""
OutputNumber = Annotated[int, Meta(ge=1, le=6)]
BaudRate = Annotated[int, Meta(ge=300, le=9600)]
Total = Annotated[int, Meta(ge=0, le=2**53)]

Stamp = Annotated[UnixTime, Meta(ge=0.0, le=32_503_680_000.0)]
"""Seconds since the epoch, to the year 3000; whether it is near enough to now, the receiver judges."""
DurationSeconds = Annotated[float, Meta(ge=0.0, le=1e7)]
ClockDifference = Annotated[float, Meta(ge=-1e11, le=1e11)]
"""Seconds between two clocks."""
Hertz = Annotated[float, Meta(ge=0.0, le=1e6)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]

LongText = Annotated[str, Meta(max_length=MAX_TEXT)]
"""A cause, a text, a diagnosis that names many units."""
ShortText = Annotated[str, Meta(max_length=MAX_WORDS)]
Id = Annotated[str, Meta(max_length=MAX_ID)]
FrameBytes = Annotated[bytes, Meta(max_length=MAX_FRAME)]
"""No frame is as long; of a longer piece of noise the beginning is kept."""
