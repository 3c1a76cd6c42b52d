"""What the metrics are made of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app.line.alarms.line_alarms import LineAlarms
from app.line.history.status import HistoryStatus
from app.line.live.bus_live import LiveState
from app.people.audit.anchor import AnchorStatus
from app.people.audit.log import Event, EventLog
from app.system.postgresql.publisher import PublisherStatus
from bus.instants import UnixTime

OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")


class CommandCounts:
    """Commands by their outcome since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.by_outcome: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Event) -> None:
        if event["kind"] == "command" and event["outcome"]:
            self.by_outcome[event["outcome"]] += 1


@dataclass(frozen=True, slots=True)
class MetricSources:
    """``pages``: how many are open now; ``anchor``: how well the audit log is anchored; ``history``: how well
    readings are stored; ``newest_backup``: when it was begun, None where there are to be none;
    ``publisher``: how well the plant's database is kept up to date, None without one; ``data``: the folder of
    the stores."""

    live: LiveState
    pages: Callable[[], int]
    commands: CommandCounts
    anchor: Callable[[], AnchorStatus]
    alarms: LineAlarms
    history: Callable[[], HistoryStatus]
    newest_backup: Callable[[], UnixTime | None]
    publisher: Callable[[], PublisherStatus | None]
    data: Path
