"""The lines that pages and the API show in short, each with its age, the worst first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from app.conditions.priority import PRIORITIES
from app.sites.summary import LineSummary

STALE_AFTER_S = 3.0
_RANKS = {level: number for number, level in enumerate((*PRIORITIES, ""))}


@dataclass(frozen=True, slots=True)
class LineOnBoard:
    """A line as reported last. ``summary`` None: it was never reported; ``age_s``: seconds since the report;
    ``server``: who reports it, empty for this server."""

    bus: str
    summary: LineSummary | None = None
    age_s: float = 0.0
    server: str = ""

    @property
    def is_stale(self) -> bool:
        """Whether its present state is unknown."""
        return self.summary is None or self.age_s > STALE_AFTER_S

    @property
    def rank(self) -> tuple[int, int, int, str]:
        """The worst first: by priority, where one that is stale counts as high at least; then alarms."""
        if self.summary is None:
            return _RANKS["high"], 0, 0, self.bus
        level = _RANKS[self.summary.level]
        known = min(level, _RANKS["high"]) if self.is_stale else level
        waiting = sum(self.summary.waiting.values())
        return known, -waiting, -sum(self.summary.active.values()), self.bus


@dataclass(frozen=True, slots=True)
class LineBoard:
    """``own``: makes the summaries of the lines of this server when they are wanted."""

    own: Callable[[], Iterable[LineSummary]]

    def lines(self) -> list[LineOnBoard]:
        """Return every line, the worst first."""
        return sorted((LineOnBoard(line.bus, line) for line in self.own()), key=lambda line: line.rank)
