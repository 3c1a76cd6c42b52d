"""Which of several alarms came first. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from bus.instants import UnixTime

WINDOW_S = 5.0
"""Alarms that rise within this time of the first belong to one disturbance."""


@dataclass(slots=True)
class FirstOut:
    """The first alarm of a disturbance of one bus. An alarm alone is not marked."""

    _first: str | None = None
    _at: UnixTime = UnixTime(0.0)

    def rise(self, alarm: str, at: UnixTime) -> str | None:
        """Take in an alarm that is annunciated; return the one that was first, or None while it is alone."""
        if self._first is None or not 0 <= at - self._at <= WINDOW_S:
            self._first, self._at = alarm, at
            return None
        return self._first if alarm != self._first else None
