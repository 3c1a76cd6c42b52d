"""What each field of a message can hold at most. Checked where a message is decoded, on both sides: neither a
worker nor an app is trusted to keep to it. NaN and the infinities are outside every range.

The ranges are those of the wire (manual, the command pages): speeds to 99999, four-byte values, one byte for
each of the analog input, outputs, inputs and errors, 40 parameters, addresses 1-255.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from bus.instants import UnixTime

MOST_UNITS = 255
MOST_UPDATES = 500
"""In a batch, so that no message takes the app's loop for long."""
MOST_FRAMES = 2_000
MOST_MEANINGS = 30
MOST_REMARKS = 20
LONGEST_TEXT = 4_000
LONGEST_MEANING = 1_000
"""Characters that are shown of what a frame means."""
LONGEST_WORDS = 300
LONGEST_ID = 200
LONGEST_FRAME = 1_024

UnitId = Annotated[int, Meta(ge=1, le=255)]
Speed = Annotated[int, Meta(ge=0, le=99_999)]
FourBytes = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
Byte = Annotated[int, Meta(ge=0, le=0xFF)]
ParameterNumber = Annotated[int, Meta(ge=1, le=40)]
OutputNumber = Annotated[int, Meta(ge=1, le=6)]
BaudRate = Annotated[int, Meta(ge=300, le=9600)]
Total = Annotated[int, Meta(ge=0, le=2**53)]
Sequence = Annotated[int, Meta(ge=0, le=2**53)]

Stamp = Annotated[UnixTime, Meta(ge=0.0, le=32_503_680_000.0)]
"""Seconds since the epoch, to the year 3000; whether it is near enough to now, the receiver judges."""
DurationSeconds = Annotated[float, Meta(ge=0.0, le=1e7)]
Hertz = Annotated[float, Meta(ge=0.0, le=1e6)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]

LongText = Annotated[str, Meta(max_length=LONGEST_TEXT)]
"""A cause, a text, a diagnosis that names many units."""
ShortText = Annotated[str, Meta(max_length=LONGEST_WORDS)]
Id = Annotated[str, Meta(max_length=LONGEST_ID)]
FrameBytes = Annotated[bytes, Meta(max_length=LONGEST_FRAME)]
"""No frame is as long; of a longer piece of noise the beginning is kept."""
