"""The trace as a text file: one frame a line, time, direction, bytes and meaning between tabs.

``2026-11-21T02:01:33.123456+00:00  out  10 02 04 81 10 03 7B  unit 4: read speed and status``

The API writes it, ``lineside decode`` reads it back.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import cast

from bus.contract import Direction, Frame
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

_DIRECTIONS = ("out", "in")


def trace_line(frame: Frame) -> str:
    """Return a frame as a line of the trace file."""
    time = datetime.fromtimestamp(float(frame.at), UTC).isoformat(timespec="microseconds")
    meaning = " ".join(frame.meaning.split())
    return f"{time}\t{frame.direction}\t{frame.data.hex(' ').upper()}\t{meaning}"


def is_trace_line(line: str) -> bool:
    """Return whether ``line`` is meant to be a line of a trace, right or wrong."""
    return line.count("\t") == 3 and line.split("\t")[1] in _DIRECTIONS


def parse_trace_line(line: str) -> Frame:
    """Parse a line. Raise CallerError for anything that :func:`trace_line` does not write."""
    try:
        time, direction, data, meaning = line.rstrip("\r\n").split("\t")
        if direction not in _DIRECTIONS:
            raise ValueError(f"direction {direction!r}")
        at = UnixTime(datetime.fromisoformat(time).timestamp())
        recorded = Message.of("frame_recorded", text=meaning)
        return Frame(at, cast(Direction, direction), bytes.fromhex(data), [recorded])
    except ValueError as error:
        raise CallerError(
            Message.of("trace_line_malformed", error=str(error), line=line.strip()[:60])
        ) from error
