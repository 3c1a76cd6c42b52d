"""The figures of a bus, about once a second, from counters that only grow. Pure."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from bus.catalogue.numbers import OWN_ADDRESS
from bus.contract import BusFigures, UnitFigures
from bus.instants import Monotonic, UnixTime
from bus.line.roster import Roster, UnitRecord
from bus.line.schedule.poll_schedule import PollSchedule
from bus.line.statistics.diagnosis import UnitSymptoms, diagnose, responds_for_all
from bus.line.statistics.wire_statistics import WireCounts

WINDOW_S = 10.0


@dataclass(frozen=True, slots=True)
class _Mark:
    at: Monotonic
    busy_s: float
    noise_bytes: int
    echoes: int
    units: dict[int, UnitFigures]


class Figures:
    """Differences over the last seconds, totals since the start."""

    def __init__(self) -> None:
        self._marks: deque[_Mark] = deque()

    def take(
        self, now: Monotonic, at: UnixTime, counts: WireCounts, roster: Roster, schedule: PollSchedule
    ) -> BusFigures:
        """The figures of this moment: ``now`` on the line's clock, ``at`` since the epoch."""
        units = {unit: roster[unit].statistics.figures() for unit in roster.configured}
        mark = _Mark(now, counts.busy_s, counts.noise_bytes, counts.echoes, units)
        before = self._before(mark)
        elapsed = now - before.at
        scan_s = schedule.scan_s()
        symptoms = [_symptoms_of(roster[unit], before.units[unit], after) for unit, after in units.items()]
        return BusFigures(
            at=at,
            scan_hz=1.0 / scan_s if scan_s > 0 else 0.0,
            scan_s=scan_s,
            wire_utilisation=min(1.0, (mark.busy_s - before.busy_s) / elapsed) if elapsed > 0 else 0.0,
            scan_s_with_one_more=schedule.scan_s(1),
            noise_bytes=counts.noise_bytes,
            echoes=counts.echoes,
            diagnosis=diagnose(symptoms, mark.noise_bytes - before.noise_bytes, mark.echoes - before.echoes),
            units=list(units.values()),
            responds_for_all=responds_for_all(symptoms),
        )

    def _before(self, mark: _Mark) -> _Mark:
        while len(self._marks) > 1 and self._marks[1].at <= mark.at - WINDOW_S:
            self._marks.popleft()
        self._marks.append(mark)
        return self._marks[0]


def _symptoms_of(record: UnitRecord, before: UnitFigures, after: UnitFigures) -> UnitSymptoms:
    return UnitSymptoms(
        unit=after.unit,
        offline=record.link.link == "offline",
        responses=after.responses - before.responses,
        timeouts=after.timeouts - before.timeouts,
        spoilt=after.checksum_errors - before.checksum_errors,
        foreign=after.foreign - before.foreign,
        late=after.late - before.late,
        own_address=record.raw(OWN_ADDRESS),
    )
