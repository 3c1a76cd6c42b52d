"""What leaves next when no operator is waiting. Pure: time in seconds is passed in.

Order of claims on the wire, the first that may use it wins:

1. the first 81h of every unit, in floor order;
2. a unit without responses whose back-off is over, all of them within a twentieth of the wire;
3. parameters needed to show a unit right, within a share that is large only while they are missing;
4. a requested slow read (a backup, a scan), within a tenth of the wire while watched;
5. the slow scan of the other parameters, within a hundredth;
6. the scan of 81h, where watched units have more turns than the others.

When no unit takes part in the scan, 3 to 5 may use all of it. Operators' writes do not pass through here:
they come before everything (``bus.line.schedule.arbiter``).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from enum import StrEnum

import msgspec

from bus.catalogue.numbers import OWN_ADDRESS
from bus.catalogue.parameters import NEEDED_TO_JUDGE, NEEDED_TO_SHOW, PARAMETERS
from bus.instants import Monotonic
from bus.line.schedule.parameter_queue import ParameterQueue
from bus.line.schedule.probe_backoff import ProbeBackoff, WireShare

MIN_SHARE_OF_A_TURN = 2 / 3
"""The least part of its rate without open pages that an unwatched unit keeps."""
WATCHED_HZ = 10.0
"""More polls a second of one unit than this show a person nothing new."""


class PollOrder:
    """Units in floor order, each with its turn; a watched one has more turns than the others.

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
        """These, where they take part, are polled at once, and more often from now on."""
        self._watched = frozenset(units)
        self._weigh()

    def take(self) -> int | None:
        """Return the unit whose turn it is; None when no unit takes part."""
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
        """Evenly over one stride from the present turn on, in the order in which they wait."""
        for rank, unit in enumerate(units):
            self._strides[unit] = stride
            self._passes[unit] = self._present + stride * rank / len(units)

    def _turn_of(self, unit: int) -> tuple[float, int, int]:
        return self._passes[unit], self._place.get(unit, len(self._place)), unit


def _strides(units: int, watched: int, poll_s: float) -> tuple[float, float]:
    """How far the pass of a watched and of another unit moves in a turn; 1 is an equal share."""
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
"""With more units than this the first seconds are shared evenly, or readings would look stale."""
SLOW_SHARE_WATCHED = 0.08
"""With fences and the slow scan beside it the scan then keeps nine tenths of its rate."""
SLOW_SHARE_UNWATCHED = 0.95
BACKGROUND_SHARE = 0.01
BURST_POLLS = 2
"""Short reads between long polls reach their share by saving up the time of so many polls."""


class TaskKind(StrEnum):
    """Why a frame leaves."""

    FIRST = "first"
    POLL = "poll"
    PROBE = "probe"
    PARAMETER = "parameter"
    SLOW = "slow"


class Task(msgspec.Struct, frozen=True):
    """The next use of the wire. ``number``: the parameter, where one is read; SLOW has no unit."""

    kind: TaskKind
    unit: int = 0
    number: int = 0
    needed: bool = False


class PollSchedule:
    """The complete claim list of one bus."""

    def __init__(self, units: Iterable[int], poll_s: float, seed: int = 0) -> None:
        order = tuple(units)
        self._unseen = list(reversed(order))
        self.poll_order = PollOrder(order, poll_s)
        self.probes = ProbeBackoff(seed)
        self.parameters = ParameterQueue(tuple(PARAMETERS), (*NEEDED_TO_SHOW, *NEEDED_TO_JUDGE, OWN_ADDRESS))
        self._needed = WireShare(NEEDED_SHARE, BURST_POLLS * poll_s)
        self._slow = WireShare(SLOW_SHARE_UNWATCHED, BURST_POLLS * poll_s)
        self._background = WireShare(BACKGROUND_SHARE)
        self._poll_s = poll_s
        """What one completed poll takes, averaged, the unit's turnaround included."""
        self._poll_fraction = 1.0

    # --- what happened -------------------------------------------------------------------------

    def watch(self, units: Collection[int]) -> None:
        """Note that ``units`` are on an open page."""
        self.poll_order.watch(units)
        self._slow.fraction = SLOW_SHARE_WATCHED if units else SLOW_SHARE_UNWATCHED

    def responded(self, unit: int, now: Monotonic) -> None:
        """``unit`` responded for the first time, or after timeouts."""
        self.probes.responded(unit, now)
        if unit in self.poll_order:
            return
        self.poll_order.join(unit)
        self.parameters.learn_all(unit)
        self._adapt()

    def stopped_responding(self, unit: int, now: Monotonic) -> None:
        """``unit`` missed so often that it is out of the round."""
        self.poll_order.leave(unit)
        self.parameters.forget(unit)
        if unit not in self.probes:
            self.probes.stopped_responding(unit, now)
        self._adapt()

    def spent(self, task: Task, began: Monotonic, ended: Monotonic, *, responded: bool) -> None:
        """``task`` used the wire between these moments; settles the shares and the averages."""
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
        """The next use of the wire; None: nothing before a probe is due."""
        if self._unseen:
            return Task(TaskKind.FIRST, self._unseen.pop())
        unit = self.probes.due(now)
        if unit is not None:
            return Task(TaskKind.PROBE, unit)
        task = self._gap(now, slow_waits=slow_waits)
        if task is not None:
            return task
        return self.next_poll() or self._gap(None, slow_waits=slow_waits)

    def next_poll(self) -> Task | None:
        """The unit whose turn it is, whatever else would be due."""
        unit = self.poll_order.take()
        return Task(TaskKind.POLL, unit) if unit is not None else None

    def _gap(self, now: Monotonic | None, *, slow_waits: bool) -> Task | None:
        """What may use a gap now; ``now`` None: the wire is free anyhow."""
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
        """Return the seconds in which every online unit is polled once, with ``more_units`` more of them."""
        units = len(self.poll_order) + more_units
        return units * self._poll_s / max(self._poll_fraction, 0.05)
