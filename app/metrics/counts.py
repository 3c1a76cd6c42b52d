"""Commands by their outcome."""

from __future__ import annotations

from collections import Counter

from app.audit.log import Event, EventLog

OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")


class Counts:
    """Commands by their outcome since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.commands: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Event) -> None:
        if event["kind"] == "command" and event["outcome"]:
            self.commands[event["outcome"]] += 1
