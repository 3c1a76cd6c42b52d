"""What follows from the readings of a unit: its mode, how it moves, and since when its conditions hold. Pure.

A unit itself reports only *at speed* (ST2 bit 7). A unit whose distance from its target shrinks is ramping;
one whose distance has not shrunk for a while is off speed. Without run, or with an emergency stop active, its
target is standstill, whatever is commanded."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

from app.line.conditions.catalogue import STATUS
from app.line.conditions.condition import BusValues, UnitValues
from bus.catalogue.parameters import CONTROL_MODE
from bus.catalogue.values import StatusBits, status_bits
from bus.contract import Reading
from bus.instants import UnixTime

KEYLOCK = 2
"""#19 of a unit whose keypad is locked (manual, 4.0)."""
_TURNING = frozenset(("turning",))


def bits_of(bus: BusValues, reading: Reading) -> StatusBits:
    """Return the status bits of a reading in the dialect of its bus."""
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy)


def is_driven(bits: StatusBits) -> bool:
    """Return whether the drive may move its motor: run input on and no emergency stop."""
    return bits.run and not bits.estop_active


def mode_of(unit: UnitValues, bits: StatusBits) -> str:
    """Return the mode: ``remote`` by ST2, else ``keylock`` or ``local`` by #19."""
    if bits.remote:
        return "remote"
    return "keylock" if unit.parameter_raw(CONTROL_MODE) == KEYLOCK else "local"


@lru_cache(maxsize=4096)
def status_conditions(bits: StatusBits) -> frozenset[str]:
    """Return the codes of the conditions that these bits show."""
    return frozenset(code for code, holds in STATUS.items() if holds(bits))


def conditions_of(bits: StatusBits, reading: Reading) -> frozenset[str]:
    """Return `status_conditions`, with ``turning`` while the actual speed of the reading is not 0."""
    found = status_conditions(bits)
    return found | _TURNING if reading.actual else found


MotionState = Literal[
    "", "at_speed", "at_zero", "ramping_up", "ramping_down", "off_speed", "stopped", "stopping", "turning"
]
"""``stopped``, ``stopping``, ``turning``: not driven; standing still, slowing down, or neither."""

PATIENCE_S = 3.0
"""A unit that has come no nearer for this long, or for three scans, is not ramping any more."""
PATIENCE_SCANS = 3


@dataclass(slots=True)
class Motion:
    """The movement of one unit towards its commanded speed, or to a standstill."""

    state: MotionState = ""
    _goal: int | None = None
    _least_error: int = 0
    _nearer_at: UnixTime = UnixTime(0.0)

    def note(self, reading: Reading, bits: StatusBits, *, scan_s: float, ratio: bool = False) -> MotionState:
        """Return the state after this reading. ``ratio``: its speeds are ratios to a master, which do not
        show whether the motor turns."""
        if reading.commanded is None or reading.actual is None:
            self.state, self._goal = "", None
            return self.state
        driven = is_driven(bits)
        goal = reading.commanded if driven else 0
        error = abs(goal - reading.actual)
        arrived = bits.at_speed if driven else error == 0
        if goal != self._goal or error < self._least_error or arrived:
            self._goal, self._least_error, self._nearer_at = goal, error, reading.at
        gave_up = reading.at - self._nearer_at > max(PATIENCE_S, PATIENCE_SCANS * scan_s)
        if driven or (reading.commanded == 0 and reading.actual == 0):
            self.state = _driven(reading.commanded, reading.actual, bits.at_speed, gave_up)
        else:
            self.state = "" if ratio else _not_driven(reading, gave_up)
        return self.state


def _driven(commanded: int, actual: int, at_speed: bool, gave_up: bool) -> MotionState:
    if commanded == 0 and actual == 0:
        return "at_zero"
    if at_speed:
        return "at_speed"
    if gave_up:
        return "off_speed"
    return "ramping_up" if commanded > actual else "ramping_down"


def _not_driven(reading: Reading, gave_up: bool) -> MotionState:
    if reading.actual == 0:
        return "stopped"
    return "turning" if gave_up else "stopping"


UNSEEN_S = 60.0
"""A condition before and after a gap of at most this, such as a restart, counts as uninterrupted."""
_NOTHING: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Onset:
    """When something began. Not ``exact``: it was first seen then and may have begun earlier."""

    at: UnixTime
    exact: bool = True


WordSpan = tuple[UnixTime, UnixTime, int]
"""From when until when the status bits of a unit were the same, and these bits as ST2 * 256 + ST1."""


@dataclass(slots=True)
class Onsets:
    """The conditions of one unit that hold now, and since when."""

    since: dict[str, Onset] = field(default_factory=dict)
    """By the code of each condition that holds, its onset."""
    _held: frozenset[str] = _NOTHING
    _seen_at: UnixTime = UnixTime(-math.inf)

    def note(self, at: UnixTime, holding: frozenset[str], change_seen_s: float) -> None:
        """Note which conditions hold by a reading. A change between two readings that are at most
        ``change_seen_s`` apart, the time after which a unit counts as offline, began with the later one; else
        its onset is not exact."""
        gap, self._seen_at = at - self._seen_at, at
        if holding == self._held and gap <= UNSEEN_S:
            return
        held = self._held if gap <= UNSEEN_S else _NOTHING
        begun = dict.fromkeys(holding - held, Onset(at, exact=gap <= change_seen_s))
        self.since = {name: onset for name, onset in self.since.items() if name in holding & held} | begun
        self._held = holding

    def correct(self, name: str, seen: Onset, found: Onset) -> bool:
        """Replace the onset ``seen`` by what was ``found`` elsewhere; return whether that is news."""
        if self.since.get(name) != seen or seen == found:
            return False
        self.since[name] = found
        return True


def later(*onsets: Onset | None) -> Onset | None:
    """Return when all of several conditions first held together; None if one of them does not hold."""
    known = [onset for onset in onsets if onset is not None]
    return max(known, key=lambda onset: onset.at) if len(known) == len(onsets) else None


def onset_in(
    spans: Sequence[WordSpan], holds: Callable[[int], bool], seen: Onset, change_seen_s: float
) -> tuple[Onset, bool]:
    """Return the onset of a condition that was first ``seen`` then, by the status bits before in order of
    time, and whether these reach back to where it began."""
    began = seen.at
    for at, until, word in reversed([span for span in spans if span[0] < seen.at]):
        gap = began - until
        if not holds(word):
            return Onset(began, exact=gap <= change_seen_s), True
        if gap > UNSEEN_S:
            return Onset(began, exact=False), True
        began = at
    return Onset(began, exact=False), False
