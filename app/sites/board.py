"""Every line that any server has reported, each with its age: in the memory of this server.

The age counts from the arrival of the report on this machine's monotonic clock, so no clock of another one
matters. A line whose server no longer reports stays as it was last reported, and states since when.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import structlog

from app.conditions.priority import PRIORITIES
from app.sites.summary import LineSummary, read_line, read_notice
from bus.instants import Monotonic, MonotonicClock, monotonic_now

STALE_AFTER_S = 3.0
"""Reports come once a second."""
FORGOTTEN_AFTER_S = 24 * 3600.0
MAX_LINES = 1000
_RANKS = {level: number for number, level in enumerate((*PRIORITIES, ""))}
_log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class LineOnBoard:
    """A line as last reported. ``summary`` None: no server has reported it since this one started; ``age_s``:
    seconds since the report."""

    bus: str
    summary: LineSummary | None = None
    age_s: float = float("inf")
    has_ended: bool = False
    """Its server has stopped."""

    @property
    def is_stale(self) -> bool:
        """Whether its present state is unknown."""
        return self.has_ended or self.age_s > STALE_AFTER_S

    @property
    def rank(self) -> tuple[int, int, int, str]:
        """The worst first: by priority, where one that is stale counts as high at least; then alarms."""
        if self.summary is None:
            return _RANKS["high"], 0, 0, self.bus
        level = _RANKS[self.summary.level]
        known = min(level, _RANKS["high"]) if self.is_stale else level
        waiting = sum(self.summary.waiting.values())
        return known, -waiting, -sum(self.summary.active.values()), self.bus


@dataclass(slots=True)
class _Reported:
    summary: LineSummary
    at: Monotonic
    has_ended: bool = False
    text: bytes = b""
    """As it was sent; empty: it was made here."""


class LineBoard:
    """``configured``: the buses that are shown even before a server reports them; ``own``: the summaries of
    the lines whose home is here, made when they are wanted."""

    def __init__(
        self,
        configured: Iterable[str],
        own: Callable[[], Iterable[LineSummary]],
        monotonic: MonotonicClock = monotonic_now,
    ) -> None:
        self._configured = tuple(configured)
        self._own = own
        self._monotonic = monotonic
        self._reported: dict[str, _Reported] = {}
        self._by_text: dict[bytes, _Reported] = {}
        self._faults: set[str] = set()

    def take(self, text: str) -> None:
        """A notification of a server. What cannot be read is logged once and passed over."""
        try:
            notice = read_notice(text)
        except ValueError as error:
            self._note_fault(error)
            return
        now = self._monotonic()
        for sent in map(bytes, notice.lines):
            self._take_line(sent, now)
        if notice.ends:
            for reported in self._reported.values():
                if reported.summary.server == notice.server:
                    reported.has_ended = True

    def lines(self) -> list[LineOnBoard]:
        """All of them, the worst first."""
        now = self._monotonic()
        for line in self._own():
            self._put(_Reported(line, now))
        for bus in [bus for bus, known in self._reported.items() if now - known.at > FORGOTTEN_AFTER_S]:
            self._by_text.pop(self._reported.pop(bus).text, None)
        found = [
            LineOnBoard(bus, known.summary, now - known.at, known.has_ended)
            for bus, known in self._reported.items()
        ]
        found += [LineOnBoard(bus) for bus in self._configured if bus not in self._reported]
        return sorted(found, key=lambda line: line.rank)

    def is_fleet(self) -> bool:
        """Whether there is more than one line to choose from."""
        return len({*self._configured, *self._reported}) > 1

    def _take_line(self, sent: bytes, now: Monotonic) -> None:
        """A former home that still reports does not overwrite the present one."""
        known = self._by_text.get(sent)
        if known is not None:
            known.at, known.has_ended = now, False
            return
        try:
            line = read_line(sent)
        except ValueError as error:
            self._note_fault(error)
            return
        known = self._reported.get(line.bus)
        if known is not None and now - known.at <= STALE_AFTER_S and line.epoch < known.summary.epoch:
            return
        if known is not None or len(self._reported) < MAX_LINES:
            self._put(_Reported(line, now, text=sent))

    def _put(self, reported: _Reported) -> None:
        bus = reported.summary.bus
        if bus in self._reported:
            self._by_text.pop(self._reported[bus].text, None)
        self._reported[bus] = reported
        if reported.text:
            self._by_text[reported.text] = reported

    def _note_fault(self, error: ValueError) -> None:
        if str(error) not in self._faults and len(self._faults) < MAX_LINES:
            self._faults.add(str(error))
            _log.warning("summary not read", why=str(error))
