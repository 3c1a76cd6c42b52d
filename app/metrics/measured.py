"""The sources of the metrics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from app.audit.anchoring import AnchorStatus
from app.audit.log import Event, EventLog
from app.live.browsers.hub import Hub
from app.live.state.bus_live import LiveState

OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")


class Counts:
    """Commands by their outcome since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.commands: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Event) -> None:
        if event["kind"] == "command" and event["outcome"]:
            self.commands[event["outcome"]] += 1


@dataclass(frozen=True, slots=True)
class MetricSources:
    """``anchor``: how well the audit log is anchored now."""

    live: LiveState
    hub: Hub
    counts: Counts
    anchor: Callable[[], AnchorStatus]
