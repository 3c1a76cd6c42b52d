"""How fast alarms come: a flood of them, and one that chatters. Pure."""

from __future__ import annotations

from collections import deque

from app.alarms.rules.performance import CHATTERS_S, FEW, MANY, WINDOW_S
from bus.instants import UnixTime

RISES_OF_CHATTER = 3
MAX_COUNTED = 1000
"""In ten minutes; of more the newest."""


class AlarmRates:
    """The alarms annunciated in the last ten minutes, as they came."""

    def __init__(self) -> None:
        self._came: deque[UnixTime] = deque(maxlen=MAX_COUNTED)
        self._of_alarm: dict[str, deque[UnixTime]] = {}
        self._is_flood = False

    def note(self, alarm: str, at: UnixTime) -> None:
        """An alarm, by its key, was annunciated."""
        self._came.append(at)
        self._of_alarm.setdefault(alarm, deque(maxlen=RISES_OF_CHATTER)).append(at)
        self.count(at)

    def count(self, now: UnixTime) -> int:
        """How many were annunciated in the last ten minutes. A clock that was set back forgets them."""
        while self._came and not 0 <= now - self._came[0] < WINDOW_S:
            self._came.popleft()
        found = len(self._came)
        self._is_flood = found > MANY or (self._is_flood and found >= FEW)
        return found

    def flood(self, now: UnixTime) -> int:
        """How many came in the last ten minutes while that is a flood: from more than ten on, until there are
        fewer than five; 0 while it is none."""
        count = self.count(now)
        return count if self._is_flood else 0

    def chatters(self, alarm: str, now: UnixTime) -> bool:
        """Whether it came three times within a minute, lately."""
        rises = self._of_alarm.get(alarm)
        if rises is None or len(rises) < RISES_OF_CHATTER or not 0 <= now - rises[-1] < WINDOW_S:
            return False
        return 0 <= rises[-1] - rises[0] <= CHATTERS_S
