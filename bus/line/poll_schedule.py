"""The schedule of one bus: which frame leaves next when no operator waits. Pure: time in seconds is passed
in.

Order of claims on the wire, the first that may use it wins:

1. the first 81h of every unit, in floor order;
2. a unit without responses whose back-off is over, all of them within a twentieth of the wire;
3. parameters needed to show a unit right, within a share that is large only while they are missing;
4. a requested slow read (a backup, a scan), within a tenth of the wire while watched;
5. the slow scan of the other parameters, within a hundredth;
6. the scan of 81h, where watched units have more turns than the others; where the configuration limits it,
the wire rests between its polls.

When no unit takes part in the scan, 3 to 5 may use all of it. Operators' writes do not pass through here:
they come before everything (``bus.line.arbiter``).
"""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import msgspec

from bus.catalogue.parameters import (
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
    NEEDED_TO_JUDGE,
    NEEDED_TO_SHOW,
    OWN_ADDRESS,
    PARAMETERS,
)
from bus.instants import Monotonic

UnitParameter = tuple[int, int]
"""A unit and the number of a parameter."""
DECIMALS_EVERY = 4
"""Of this many reads of the slow scan one is of #3, so that a first reading of all other parameters ends
soon."""
_FIRST = (DECIMALS, FOLLOWER_MODE, MAX_DISPLAY)
"""The parameters that are read of all units before the other needed ones, in this order: without decimals no
speed can be shown right, and a setpoint waits until its bounds, the mode and #2, are read."""
_RANKS = {number: rank for rank, number in enumerate(_FIRST)}


class ParameterQueue:
    """Two queues of 85h reads: those needed to show a unit right, and a slow scan of all others.

    The needed ones go number by number over all units, so that all units are shown right together. The slow
    scan never ends: a parameter that was read goes to its end, so that changes at a panel are found. Every
    fourth read of it is #3 of the next unit, because decimals changed at a panel make every shown speed
    wrong.
    """

    def __init__(self, numbers: Sequence[int], needed: Collection[int]) -> None:
        self._numbers = tuple(numbers)
        self._needed_numbers = frozenset(needed)
        self._needed: dict[UnitParameter, tuple[int, int, int]] = {}
        """The needed parameters, each with its rank; the lowest rank is read first."""
        self._background: dict[UnitParameter, None] = {}
        self._decimals: dict[UnitParameter, None] = {}
        self._arrivals = 0
        self._turn = 0

    def learn_all(self, unit: int) -> None:
        """Queue every parameter of ``unit``, because it is new or has returned."""
        self.forget(unit)
        self.need(unit)
        for number in self._numbers:
            if number not in self._needed_numbers:
                self._add_background(unit, number)

    def need(self, unit: int) -> None:
        """Queue again the parameters that are needed to show ``unit`` right."""
        for number in self._needed_numbers:
            self._add_needed(unit, number, _RANKS.get(number, len(_FIRST)))

    def forget(self, unit: int) -> None:
        """Remove ``unit``, which does not respond, from all queues."""
        for queue in (self._needed, self._background, self._decimals):
            for entry in [entry for entry in queue if entry[0] == unit]:
                del queue[entry]

    def next_needed(self) -> UnitParameter | None:
        """Return unit and number of the next needed parameter, and remove it from the queue."""
        if not self._needed:
            return None
        entry = min(self._needed, key=self._needed.__getitem__)
        del self._needed[entry]
        return entry

    def next_background(self) -> UnitParameter | None:
        """Return unit and number of the next parameter of the slow scan, and remove it from there."""
        self._turn = (self._turn + 1) % DECIMALS_EVERY
        queue = (self._background or self._decimals) if self._turn else (self._decimals or self._background)
        if not queue:
            return None
        entry = next(iter(queue))
        del queue[entry]
        return entry

    @property
    def any_needed(self) -> bool:
        return bool(self._needed)

    @property
    def any_background(self) -> bool:
        return bool(self._background or self._decimals)

    def was_read(self, unit: int, number: int, *, available: bool) -> None:
        """Queue a parameter again at the end of the slow scan, unless the unit does not have it."""
        if available and number in self._numbers:
            self._add_background(unit, number)

    def was_not_read(self, unit: int, number: int) -> None:
        """Put a parameter without a response back into its queue."""
        if number in self._needed_numbers:
            self._add_needed(unit, number, len(_FIRST))
        else:
            self._add_background(unit, number)

    def _add_needed(self, unit: int, number: int, rank: int) -> None:
        self._arrivals += 1
        self._needed.setdefault((unit, number), (rank, number, self._arrivals))

    def _add_background(self, unit: int, number: int) -> None:
        queue = self._decimals if number == DECIMALS else self._background
        queue.setdefault((unit, number))


class WireShare:
    """A limit on a use of the wire to at most ``fraction`` of the time, however long one use is.

    Unused time can be saved up for ``burst_s`` seconds of waiting, so that short uses between long ones of
    others still reach the complete fraction. Pure: ``now`` in seconds is passed in.
    """

    def __init__(self, fraction: float, burst_s: float = 0.0) -> None:
        self.fraction = fraction
        self.burst_s = burst_s
        self.ready_at = Monotonic(float("-inf"))
        """The moment from which the wire may be used again."""

    def ready(self, now: Monotonic) -> bool:
        return now >= self.ready_at

    def spend(self, now: Monotonic, seconds: float) -> None:
        """Note that the wire was used for ``seconds``, beginning at ``now``."""
        self.ready_at = max(self.ready_at, now - self.burst_s) + seconds / self.fraction


STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0, 10.0)
"""The pauses in seconds after each further probe without a response."""
ALONE_STEP_S = 1.0
"""The longest pause in seconds while no unit responds: probes then delay no other unit."""
JITTER = 0.2
"""The largest part by which a pause is shortened, so that units lost together are not probed together."""
WIRE_SHARE = 0.05
"""The part of the wire for probes of all units without responses."""
WIRE_SHARE_ALONE = 0.5
"""The part of the wire for probes while no unit responds: a line switched on again is found at once."""


@dataclass(slots=True)
class _OfflineUnit:
    step: int
    due: Monotonic


class ProbeBackoff:
    """The units that do not respond, and when each is probed next.

    One probe costs one timeout; the timeouts of all are rationed to ``WIRE_SHARE``. A probe with a response
    costs nothing, so a complete line that comes back is found as fast as it responds.
    """

    def __init__(self, seed: int = 0) -> None:
        self._units: dict[int, _OfflineUnit] = {}
        self._rations = _rations()
        self._random = random.Random(seed)
        self.alone = True
        """Whether no unit responds; set by the schedule."""

    def __len__(self) -> int:
        return len(self._units)

    def __contains__(self, unit: int) -> bool:
        return unit in self._units

    def stopped_responding(self, unit: int, now: Monotonic) -> None:
        """Note that ``unit`` stopped responding, or did not respond to its first request."""
        self._units[unit] = _OfflineUnit(0, now + self._wait(0))

    def no_response(self, unit: int, now: Monotonic, cost_s: float) -> None:
        """Note that a probe of ``unit`` cost a timeout of ``cost_s`` seconds, which ended at ``now``."""
        self._rations[self.alone].spend(now, cost_s)
        offline = self._units.get(unit)
        if offline is not None:
            offline.step = min(offline.step + 1, len(STEPS_S) - 1)
            offline.due = now + self._wait(offline.step)

    def responded(self, unit: int, now: Monotonic) -> None:
        """Note that ``unit`` responds again; others may have had the same cause, so make them due now."""
        if self._units.pop(unit, None) is not None:
            for other in self._units.values():
                other.due = min(other.due, now)

    def forgive(self, now: Monotonic) -> None:
        """Make every unit due at once and restore the rations, whatever was spent before."""
        self._rations = _rations()
        for offline in self._units.values():
            offline.step, offline.due = 0, min(offline.due, now)

    def due(self, now: Monotonic) -> int | None:
        """Return the unit to probe now, the longest overdue first, or None if none is due or the ration is
        used up."""
        if not self._units or not self._rations[self.alone].ready(now):
            return None
        unit = min(self._units, key=lambda each: self._due_of(self._units[each]))
        return unit if self._due_of(self._units[unit]) <= now else None

    def wake_at(self) -> Monotonic | None:
        """Return when the next probe may leave; None if all units respond."""
        if not self._units:
            return None
        first_due = min(self._due_of(offline) for offline in self._units.values())
        return max(self._rations[self.alone].ready_at, first_due)

    def _wait(self, step: int) -> float:
        return STEPS_S[step] * (1.0 - JITTER * self._random.random())

    def _due_of(self, offline: _OfflineUnit) -> Monotonic:
        if not self.alone:
            return offline.due
        late = max(0.0, STEPS_S[offline.step] - ALONE_STEP_S)
        return offline.due - late


def _rations() -> dict[bool, WireShare]:
    """Return the rations of probes, by whether no unit responds: the ration is larger then."""
    return {False: WireShare(WIRE_SHARE), True: WireShare(WIRE_SHARE_ALONE)}


LOOK_ELSEWHERE_S = 3.0
"""The seconds for which a silent line is polled at one baud rate before the other is tried."""


class BaudSearch:
    """The search for the baud rate of a line without responses: call ``turn`` between two requests.

    Units take a new baud rate (#18) when they are switched off and on, one after the other, without notice.
    Therefore such a line is polled at its old rate and at its new one in turn, until it responds at the new
    one: no unit returns to the old rate, so a timeout is only a timeout from then on.
    """

    def __init__(self, now: Monotonic) -> None:
        self._expected: int | None = None
        self._old: int | None = None
        self._tuned_at = now

    def expect(self, baud: int, present: int) -> None:
        """Expect units that respond at ``present`` to come up at ``baud`` once they have been switched off
        and on. Equal rates end an earlier expectation."""
        self._expected, self._old = (None, None) if baud == present else (baud, present)

    def tuned(self, now: Monotonic) -> None:
        """Note that the port goes at another rate from ``now`` on."""
        self._tuned_at = now

    def turn(self, now: Monotonic, baud: int, *, responds: bool) -> int | None:
        """Return the rate to continue at if it is time to leave ``baud``, else None. ``responds``: whether
        any unit does at ``baud``."""
        if responds and baud == self._expected:
            self._expected = self._old = None
        if responds or now - self._tuned_at <= LOOK_ELSEWHERE_S:
            return None
        return self._old if baud == self._expected else self._expected


MIN_SHARE_OF_A_TURN = 2 / 3
"""The least part of its rate without open pages that an unwatched unit keeps."""
WATCHED_HZ = 10.0
"""The most polls a second of one unit that show a person anything new."""


class PollOrder:
    """The turns of the units in floor order; a watched unit has more turns than the others.

    Each unit has a *pass*; the lowest is next and moves on by the inverse of its share (stride scheduling),
    so no unit starves and equal units take exact turns. Whenever shares change the passes are spread evenly;
    otherwise a watched unit would have all its turns together, between two scans of the others.
    """

    def __init__(self, floor_order: Iterable[int], poll_s: float) -> None:
        self._place = {unit: place for place, unit in enumerate(floor_order)}
        self._poll_s = poll_s
        self._passes: dict[int, float] = {}
        self._watched: frozenset[int] = frozenset()
        self._strides: dict[int, float] = {}
        self._present = 0.0

    def __len__(self) -> int:
        return len(self._passes)

    def __contains__(self, unit: int) -> bool:
        return unit in self._passes

    def join(self, unit: int) -> None:
        """Add ``unit`` as the last, because it has just responded; missed turns are not made up for."""
        if unit not in self._passes:
            self._passes[unit] = math.inf
            self._weigh()

    def leave(self, unit: int) -> None:
        if self._passes.pop(unit, None) is not None:
            self._weigh()

    def watch(self, units: Collection[int]) -> None:
        """Poll ``units``, if they take part, at once and more often from now on."""
        self._watched = frozenset(units)
        self._weigh()

    def next_unit(self) -> int | None:
        """Return the unit whose turn it is; None if no unit takes part."""
        if not self._passes:
            return None
        unit = min(self._passes, key=self._turn_of)
        self._present = self._passes[unit]
        self._passes[unit] += self._strides[unit]
        return unit

    def _weigh(self) -> None:
        waiting = sorted(self._passes, key=self._turn_of)
        watched = [unit for unit in waiting if unit in self._watched]
        others = [unit for unit in waiting if unit not in self._watched]
        extra, plain = _strides(len(self), len(watched), self._poll_s)
        self._spread(watched, extra)
        self._spread(others, plain)

    def _spread(self, units: list[int], stride: float) -> None:
        """Spread ``units``, as they wait, evenly over one stride from the present turn on."""
        for rank, unit in enumerate(units):
            self._strides[unit] = stride
            self._passes[unit] = self._present + stride * rank / len(units)

    def _turn_of(self, unit: int) -> tuple[float, int, int]:
        return self._passes[unit], self._place.get(unit, len(self._place)), unit


def _strides(units: int, watched: int, poll_s: float) -> tuple[float, float]:
    """Return how far the pass of a watched and of another unit moves in a turn; 1 is an equal share."""
    others = units - watched
    if watched == 0 or others == 0:
        return 1.0, 1.0
    equal = 1.0 / units
    left_by_others = 1.0 - MIN_SHARE_OF_A_TURN * others * equal
    each = max(equal, min(left_by_others / watched, WATCHED_HZ * poll_s))
    each_other = (1.0 - watched * each) / others
    return equal / each, equal / each_other


NEEDED_SHARE = 0.8
NEEDED_SHARE_OF_MANY = 0.5
MANY_UNITS = 12
"""The number of units above which needed parameters get the smaller share, or readings would look stale
meanwhile."""
SLOW_SHARE_WATCHED = 0.08
"""A share that, with fences and the slow scan beside it, leaves the scan nine tenths of its rate."""
SLOW_SHARE_UNWATCHED = 0.95
BACKGROUND_SHARE = 0.01
BURST_POLLS = 2
"""The number of polls whose time can be saved up, so that short reads between long polls reach their
share."""


class TaskKind(StrEnum):
    """The reason why a frame leaves."""

    FIRST = "first"
    POLL = "poll"
    PROBE = "probe"
    PARAMETER = "parameter"
    SLOW = "slow"


class Task(msgspec.Struct, frozen=True):
    """The next use of the wire. ``number``: the parameter, if one is read; SLOW has no unit."""

    kind: TaskKind
    unit: int = 0
    number: int = 0
    needed: bool = False


class PollSchedule:
    """The schedule of one bus with all claims on its wire. ``least_scan_s``: the shortest time of a scan."""

    def __init__(
        self, units: Iterable[int], poll_s: float, seed: int = 0, *, least_scan_s: float = 0.0
    ) -> None:
        order = tuple(units)
        self._unseen = list(reversed(order))
        self.poll_order = PollOrder(order, poll_s)
        self.probes = ProbeBackoff(seed)
        self.parameters = ParameterQueue(tuple(PARAMETERS), (*NEEDED_TO_SHOW, *NEEDED_TO_JUDGE, OWN_ADDRESS))
        self._needed = WireShare(NEEDED_SHARE, BURST_POLLS * poll_s)
        self._slow = WireShare(SLOW_SHARE_UNWATCHED, BURST_POLLS * poll_s)
        self._background = WireShare(BACKGROUND_SHARE)
        self._poll_s = poll_s
        """The average seconds of one completed poll, the unit's turnaround included."""
        self._poll_fraction = 1.0
        self._least_scan_s = least_scan_s
        self._poll_due = Monotonic(-math.inf)
        """The time when the next poll of the scan may leave."""

    # --- what happened -------------------------------------------------------------------------

    def watch(self, units: Collection[int]) -> None:
        """Note that ``units`` are on an open page."""
        self.poll_order.watch(units)
        self._slow.fraction = SLOW_SHARE_WATCHED if units else SLOW_SHARE_UNWATCHED

    def responded(self, unit: int, now: Monotonic) -> None:
        """Note that ``unit`` responded for the first time, or after timeouts."""
        self.probes.responded(unit, now)
        if unit in self.poll_order:
            return
        self.poll_order.join(unit)
        self.parameters.learn_all(unit)
        self._adapt()

    def stopped_responding(self, unit: int, now: Monotonic) -> None:
        """Take ``unit`` out of the scan, because it missed too many requests."""
        self.poll_order.leave(unit)
        self.parameters.forget(unit)
        if unit not in self.probes:
            self.probes.stopped_responding(unit, now)
        self._adapt()

    def spent(self, task: Task, began: Monotonic, ended: Monotonic, *, responded: bool) -> None:
        """Note that ``task`` used the wire from ``began`` to ``ended``, in the shares and the averages."""
        seconds = ended - began
        match task.kind:
            case TaskKind.PROBE if not responded:
                self.probes.no_response(task.unit, ended, seconds)
            case TaskKind.PARAMETER:
                (self._needed if task.needed else self._background).spend(began, seconds)
            case TaskKind.SLOW:
                self._slow.spend(began, seconds)
            case TaskKind.POLL if responded:
                self._poll_s += (seconds - self._poll_s) * 0.05
        polled = 1.0 if task.kind is TaskKind.POLL else 0.0
        weight = min(1.0, seconds / 5.0)
        self._poll_fraction += (polled - self._poll_fraction) * weight

    # --- the next claim ------------------------------------------------------------------------

    def next(self, now: Monotonic, *, slow_waits: bool = False) -> Task | None:
        """Return the next use of the wire, or None if nothing is due before one of ``moments``."""
        if self._unseen:
            return Task(TaskKind.FIRST, self._unseen.pop())
        unit = self.probes.due(now)
        if unit is not None:
            return Task(TaskKind.PROBE, unit)
        task = self._gap(now, slow_waits=slow_waits)
        if task is not None:
            return task
        if not self.poll_may_leave(now):
            return None
        return self.next_poll(now) or self._gap(None, slow_waits=slow_waits)

    def poll_may_leave(self, now: Monotonic) -> bool:
        """Return whether the limit of the scan allows a poll now."""
        return now >= self._poll_due or len(self.poll_order) == 0

    def next_poll(self, now: Monotonic) -> Task | None:
        """Return the poll of the unit whose turn it is, whatever else is due."""
        unit = self.poll_order.next_unit()
        if unit is None:
            return None
        apart_s = self._least_scan_s / len(self.poll_order)
        # A poll that leaves a little late does not delay those after it; missed polls are not made up for.
        self._poll_due = (self._poll_due if now - self._poll_due < apart_s else now) + apart_s
        return Task(TaskKind.POLL, unit)

    def moments(self, *, slow_waits: bool) -> list[Monotonic]:
        """Return the moments at which something that is not due now may become due."""
        probe = self.probes.wake_at()
        moments = [] if probe is None else [probe]
        if self._least_scan_s == 0 or len(self.poll_order) == 0:
            # Without a limit of the scan only probes are waited for: everything else is due at once.
            return moments
        moments.append(self._poll_due)
        if self.parameters.any_needed:
            moments.append(self._needed.ready_at)
        if self.parameters.any_background:
            moments.append(self._background.ready_at)
        if slow_waits:
            moments.append(self._slow.ready_at)
        return moments

    def _gap(self, now: Monotonic | None, *, slow_waits: bool) -> Task | None:
        """Return the read that may use a gap now. ``now``: None if the wire is free anyhow."""
        if (now is None or self._needed.ready(now)) and (wanted := self.parameters.next_needed()):
            return Task(TaskKind.PARAMETER, *wanted, needed=True)
        if slow_waits and (now is None or self._slow.ready(now)):
            return Task(TaskKind.SLOW)
        if (now is None or self._background.ready(now)) and (wanted := self.parameters.next_background()):
            return Task(TaskKind.PARAMETER, *wanted)
        return None

    def _adapt(self) -> None:
        self.probes.alone = len(self.poll_order) == 0
        self._needed.fraction = NEEDED_SHARE if len(self.poll_order) <= MANY_UNITS else NEEDED_SHARE_OF_MANY

    # --- what it costs -------------------------------------------------------------------------

    def scan_s(self, more_units: int = 0) -> float:
        """Return the seconds in which every online unit, and ``more_units`` beside, is polled once."""
        units = len(self.poll_order) + more_units
        possible_s = units * self._poll_s / max(self._poll_fraction, 0.05)
        return max(possible_s, self._least_scan_s) if units else possible_s
