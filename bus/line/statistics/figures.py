"""The figures of a bus, about once a second, from counters that only grow, with the likely cause of faults.
Pure.

One unit: its drop or its address. All: adapter, main cable or termination. All from one place on: the cable
there. Damaged bytes at many: shielding. Damaged bytes at one address only: two units may share it. All but
one respond twice, or damaged: that one responds for the others too. Where it does so for one that is off, no
frame shows it; only the address that the responding unit reads in #17 does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec

from bus.catalogue.numbers import OWN_ADDRESS
from bus.contract import BusFigures, UnitFigures
from bus.instants import Monotonic, UnixTime
from bus.line.roster import Roster, UnitRecord
from bus.line.schedule.poll_schedule import PollSchedule
from bus.line.statistics.counters import WireCounts
from bus.messages import Message

WINDOW_S = 10.0


@dataclass(frozen=True, slots=True)
class _Mark:
    at: Monotonic
    wire: WireCounts
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
        self._marks.append(_Mark(now, replace(counts), units))
        while len(self._marks) > 1 and self._marks[1].at <= now - WINDOW_S:
            self._marks.popleft()
        before = self._marks[0]
        elapsed = now - before.at
        scan_s = schedule.scan_s()
        symptoms = [_symptoms_of(roster[unit], before.units[unit], after) for unit, after in units.items()]
        return BusFigures(
            at=at,
            scan_hz=1.0 / scan_s if scan_s > 0 else 0.0,
            scan_s=scan_s,
            wire_utilisation=min(1.0, (counts.busy_s - before.wire.busy_s) / elapsed) if elapsed > 0 else 0.0,
            scan_s_with_one_more=schedule.scan_s(1),
            noise_bytes=counts.noise_bytes,
            echoes=counts.echoes,
            diagnosis=diagnose(
                symptoms, counts.noise_bytes - before.wire.noise_bytes, counts.echoes - before.wire.echoes
            ),
            units=list(units.values()),
            responds_for_all=responds_for_all(symptoms),
        )


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


TROUBLED = 0.1
"""A unit has a fault when it misses or damages more than this part of its responses."""
FEW = 3
"""Fewer events than this are chance."""
MANY = 3
"""The number of units from which one can be distinguished from all others."""
LATE_PART = 0.05
MUCH_NOISE_BYTES = 100
COLLIDED_BYTES = 20
"""The remains of a few simultaneous responses of two units; units that are off leave nothing."""


class UnitSymptoms(msgspec.Struct, frozen=True):
    """One unit's counts in the window. ``spoilt``: wrong checksum. ``own_address``: #17, None if not read."""

    unit: int
    offline: bool = False
    responses: int = 0
    timeouts: int = 0
    spoilt: int = 0
    foreign: int = 0
    late: int = 0
    own_address: int | None = None

    @property
    def requests(self) -> int:
        return self.responses + self.timeouts

    @property
    def unresponsive(self) -> bool:
        return self.offline or (self.timeouts >= FEW and self.timeouts > TROUBLED * self.requests)

    @property
    def garbled(self) -> bool:
        return self.spoilt >= FEW and self.spoilt > TROUBLED * self.requests

    @property
    def slow(self) -> bool:
        return self.late >= FEW and self.late > LATE_PART * self.requests

    @property
    def twice(self) -> bool:
        """Unrequested frames carry its address: a late response would have timed out before."""
        return self.slow and self.timeouts < FEW


def diagnose(units: Sequence[UnitSymptoms], noise_bytes: int, echoes: int) -> list[Message]:
    """One or two causes; empty when all is well."""
    found = [_in_another_name(units), _garbled(units), _collided(units, noise_bytes) or _unresponsive(units)]
    if (all_twice := responds_for_all(units)) != 0:
        found.append(Message.of("diagnosis_all_twice", unit=all_twice))
    else:
        found += [
            _named("diagnosis_late", [each for each in units if each.slow]),
            _named("diagnosis_foreign", [each for each in units if each.foreign >= FEW]),
        ]
    if echoes:
        found.append(Message("diagnosis_echo"))
    if noise_bytes >= MUCH_NOISE_BYTES:
        found.append(_noise(units, named=any(found)))
    return [each for each in found if each is not None]


def responds_for_all(units: Sequence[UnitSymptoms]) -> int:
    """Return the unit that responds to every address, as all others are received twice; 0: none."""
    responding = [each for each in units if not each.unresponsive]
    alone = [each for each in responding if not each.twice]
    return alone[0].unit if len(alone) == 1 and len(responding) >= MANY and alone[0].responses else 0


def _in_another_name(units: Sequence[UnitSymptoms]) -> Message | None:
    others = [each for each in units if each.own_address not in (None, each.unit) and not each.unresponsive]
    if not others or (own := others[0].own_address) is None:
        return None
    same = _addresses([each for each in others if each.own_address == own])
    return Message.of("diagnosis_other_name", units=same, own=own)


def _collided(units: Sequence[UnitSymptoms], noise_bytes: int) -> Message | None:
    alone = [each.unit for each in units if not each.unresponsive]
    if len(alone) != 1 or len(units) < MANY or noise_bytes < COLLIDED_BYTES:
        return None
    return Message.of("diagnosis_collisions", unit=alone[0])


def _unresponsive(units: Sequence[UnitSymptoms]) -> Message | None:
    unresponsive = [each for each in units if each.unresponsive and not each.garbled]
    if not unresponsive:
        return None
    if len(unresponsive) == len(units) and len(units) > 1:
        return Message("diagnosis_no_response")
    if len(unresponsive) == 1:
        return Message.of("diagnosis_one_silent", unit=unresponsive[0].unit)
    first = units.index(unresponsive[0])
    if list(units[first:]) == unresponsive and first > 0:
        return Message.of("diagnosis_silent_from", unit=unresponsive[0].unit, before=units[first - 1].unit)
    return Message.of("diagnosis_some_silent", units=_addresses(unresponsive))


def _garbled(units: Sequence[UnitSymptoms]) -> Message | None:
    garbled = [each for each in units if each.garbled]
    if not garbled:
        return None
    if len(garbled) == 1 and len(units) > 1:
        return Message.of("diagnosis_one_garbled", unit=garbled[0].unit)
    if len(garbled) == len(units):
        return Message("diagnosis_all_garbled")
    return Message.of("diagnosis_some_garbled", units=_addresses(garbled))


def _noise(units: Sequence[UnitSymptoms], *, named: bool) -> Message | None:
    if any(each.unresponsive and not each.garbled for each in units):
        return Message("diagnosis_other_protocol")
    return None if named else Message("diagnosis_stray_bytes")


def _named(code: str, units: Sequence[UnitSymptoms]) -> Message | None:
    return Message.of(code, units=_addresses(units)) if units else None


def _addresses(units: Sequence[UnitSymptoms]) -> list[int]:
    return [each.unit for each in units]
