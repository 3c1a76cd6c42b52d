"""When a process that does not respond is given up. Pure: looks are counted, not seconds, so that a stall of
the one who looks does not count as a stall of the process."""

from __future__ import annotations

from dataclasses import dataclass

LOOK_S = 1.0
MAX_MISSED = 10
"""Looks without a response. They begin 5 s after the last message, when the feed gives a worker up, and
opening a port takes far less."""
MAX_MISSED_AT_START = 120
"""Before the first response: on a small machine many workers import their code at the same time."""


@dataclass(slots=True)
class Watchdog:
    """Watches one process."""

    missed: int = 0
    limit: int = MAX_MISSED_AT_START
    has_looked: bool = False

    def expires(self, *, responds: bool) -> bool:
        """Look once; True where the process has been without a response for too long."""
        if not self.has_looked:
            # What responded may have been the process before.
            self.has_looked = True
        elif responds:
            self.missed, self.limit = 0, MAX_MISSED
        else:
            self.missed += 1
        return self.missed >= self.limit
