"""The diagnosis of a bus from its counts: its figures, the likely cause of faults, a second master. Pure.

The figures are taken about once a second from counters that only grow. Faults of one unit point to its drop
or its address; of all units to the adapter, the main cable or the termination; of all units behind one place
to the cable there. Damaged bytes at many units point to the shielding, at one address to two units that share
it. If all units but one respond twice, or damaged, that one responds for the others too. If it does so for a
unit that is off, no frame shows it, only the address that it reads in #17.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec

from bus.catalogue.parameters import OWN_ADDRESS
from bus.contract import FEW, TROUBLED, BusFigures, UnitFigures
from bus.instants import Monotonic, UnixTime
from bus.line.poll_schedule import PollSchedule
from bus.line.roster import Roster, UnitRecord, WireCounts
from bus.messages import Message

MIN_RESPONSES = 3
"""The least number of unrequested responses that are more than chance."""
WITHIN_S = 2.0
CLEAR_AFTER_S = 10.0
"""The seconds that the wire must be free of unrequested responses before this host writes again."""
MAX_OUTSTANDING = 16
LATE_WITHIN_S = 60.0
"""The most responses of a unit that may be late, and the most seconds. A unit without a response is polled at
most ten times in a minute, so after a standstill of a minute these two explain each response that comes."""


class SecondMaster:
    """The evidence of another host on the wire: ``note`` each unrequested response. While it ``is_present``
    this host sends no write except those that stop a unit, because two hosts would set each other's speeds.

    A host does not receive the requests of another, only the responses of the units to them: frames beside
    the response to its own request, or while it awaits none. A unit with a wrong address responds in the
    place of the one that was requested. A unit that is late sends as many responses as it had requests, all
    of them at once if a device server or its network stood still. A frame that a unit sends while it is
    itself requested may be its own fault.
    """

    def __init__(self) -> None:
        self.noted = 0
        """Responses that no request of this host explains, counted since the worker started."""
        self._noted: deque[Monotonic] = deque(maxlen=MIN_RESPONSES)
        self._until: Monotonic | None = None
        self._outstanding: defaultdict[int, deque[Monotonic]] = defaultdict(
            lambda: deque(maxlen=MAX_OUTSTANDING)
        )
        """The time when this host sent each request without a response, by unit."""

    def requested(self, unit: int, now: Monotonic) -> None:
        """Note that this host sent a request."""
        self._outstanding[unit].append(now)

    def responded(self, unit: int) -> None:
        """Note that a unit responded to the newest request."""
        if self._outstanding[unit]:
            self._outstanding[unit].pop()

    def explains(self, unit: int, now: Monotonic) -> bool:
        """Return whether a response of a unit may belong to an earlier request of this host; that request is
        then settled."""
        outstanding = self._outstanding[unit]
        while outstanding and now - outstanding[0] > LATE_WITHIN_S:
            outstanding.popleft()
        if outstanding:
            outstanding.popleft()
            return True
        return False

    def note(self, now: Monotonic) -> None:
        """Note that a unit responded to something that this host did not request."""
        self.noted += 1
        self._noted.append(now)
        is_frequent = len(self._noted) == MIN_RESPONSES and now - self._noted[0] <= WITHIN_S
        if is_frequent or self.is_present(now):
            self._until = now + CLEAR_AFTER_S

    def is_present(self, now: Monotonic) -> bool:
        """Return whether another host is on the wire."""
        return self._until is not None and now < self._until


WINDOW_S = 10.0


@dataclass(frozen=True, slots=True)
class _Mark:
    at: Monotonic
    wire: WireCounts
    units: dict[int, UnitFigures]


class Figures:
    """The figures of a bus: differences over the last seconds, and totals since the start."""

    def __init__(self) -> None:
        self._marks: deque[_Mark] = deque()

    def measure(
        self, now: Monotonic, at: UnixTime, counts: WireCounts, roster: Roster, schedule: PollSchedule
    ) -> BusFigures:
        """Return the present figures. ``now``: on the line's clock; ``at``: Unix time in seconds."""
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


MANY = 3
"""The least number of units from which one can be distinguished from all others."""
LATE_PART = 0.05
MUCH_NOISE_BYTES = 100
COLLIDED_BYTES = 20
"""The least number of bytes that collided responses of two units leave; units that are off leave none."""


class UnitSymptoms(msgspec.Struct, frozen=True):
    """The counts of one unit in the window. ``spoilt``: wrong checksum. ``own_address``: #17, if read."""

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
        """Whether unrequested frames carry its address; a late response would have timed out before."""
        return self.slow and self.timeouts < FEW


def diagnose(units: Sequence[UnitSymptoms], noise_bytes: int, echoes: int) -> list[Message]:
    """Return one or two likely causes of faults, none if all is well."""
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
    """Return the unit that responds to every address, as all others are received twice; 0 for none."""
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
