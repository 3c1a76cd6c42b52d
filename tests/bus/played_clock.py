"""A clock of a line that stands still until a test moves it on."""

from __future__ import annotations

from collections.abc import Callable

from bus.line.timing import Timer

Entry = tuple[float, Callable[[], None]]


class PlayedClock:
    """``alarms``: what is to ring, and when."""

    def __init__(self) -> None:
        self.time = 100.0
        self.alarms: list[Entry] = []

    def now(self) -> float:
        return self.time

    def epoch(self, now: float) -> float:
        return now

    def settle(self) -> None:
        """There is no other clock to follow."""

    def call_at(self, when: float, callback: Callable[[], None]) -> Timer:
        entry = (when, callback)
        self.alarms.append(entry)
        return _Set(self.alarms, entry)

    def pass_to(self, until: float, stalled_until: float = 0.0) -> None:
        """Ring what is due until then; in a process that is stalled, nothing before ``stalled_until``."""
        while self.alarms and min(self.alarms, key=_when)[0] <= until:
            alarm = min(self.alarms, key=_when)
            self.alarms.remove(alarm)
            self.time = max(self.time, alarm[0], stalled_until)
            alarm[1]()
        self.time = max(self.time, until)


def _when(entry: Entry) -> float:
    return entry[0]


class _Set:
    def __init__(self, alarms: list[Entry], entry: Entry) -> None:
        self._alarms, self._entry = alarms, entry

    def cancel(self) -> None:
        if self._entry in self._alarms:
            self._alarms.remove(self._entry)
