"""How long a change of several units takes on the wire. Pure: byte counts (manual, 2.2) at a baud rate."""

from __future__ import annotations

from bus.settings import wire_seconds

POLL_BYTES = 7 + 18
"""81h and its response."""
_STAGE_BYTES = 11
"""82h with four data bytes."""
_DOUBLED_BYTES = 4
"""What it grows by when every data byte is 10h."""
_ACK_BYTES = 7
_EXECUTE_BYTES = 7
_READ_BYTES = 8 + 8
"""85h and a value of one byte."""
_LONG_VALUE_BYTES = 7
"""What its response grows by for four bytes of 10h."""


def stage_s(baud: int, reads: int = 0) -> float:
    """82h to one unit of several and its acknowledgement at best, seconds, after so many ``reads``."""
    return wire_seconds(_STAGE_BYTES + _ACK_BYTES + reads * _READ_BYTES, baud)


def longest_stage_s(baud: int, turnaround_s: float, reads: int = 0) -> float:
    """The same at worst, without a retry. ``turnaround_s``: what a unit may take to begin its response."""
    stage = wire_seconds(_STAGE_BYTES + _DOUBLED_BYTES + _ACK_BYTES, baud) + turnaround_s
    return stage + reads * (wire_seconds(_READ_BYTES + _LONG_VALUE_BYTES, baud) + turnaround_s)


def change_s(units: int, baud: int) -> float:
    """Stage each of ``units``, one broadcast, read each back at best, seconds."""
    return units * stage_s(baud) + wire_seconds(_EXECUTE_BYTES + units * POLL_BYTES, baud)
