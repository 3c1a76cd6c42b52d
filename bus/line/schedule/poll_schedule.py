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

from collections.abc import Collection, Iterable
from enum import StrEnum

import msgspec

from bus.catalogue.numbers import OWN_ADDRESS
from bus.catalogue.parameters import NEEDED_TO_JUDGE, NEEDED_TO_SHOW, PARAMETERS
from bus.instants import Monotonic
from bus.line.schedule.parameter_queue import ParameterQueue
from bus.line.schedule.poll_order import PollOrder
from bus.line.schedule.probe_backoff import ProbeBackoff, WireShare

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
        self._poll_fraction = 1.0

    # --- what happened -------------------------------------------------------------------------

    def watch(self, units: Collection[int], *, any_page: bool) -> None:
        """Set the ``units`` on an open page; ``any_page``: some page is open at all."""
        self.poll_order.watch(units)
        self._slow.fraction = SLOW_SHARE_WATCHED if any_page else SLOW_SHARE_UNWATCHED

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

    def port_opened(self, now: Monotonic) -> None:
        """The port is open again: units without responses are due for a probe."""
        self.probes.forgive(now)

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
        """The next use of the wire; None: nothing before ``wake_at``."""
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

    def wake_at(self) -> Monotonic | None:
        """When something becomes due, after ``next`` had nothing; None: only when something happens."""
        return self.probes.wake_at()

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

    @property
    def poll_s(self) -> float:
        """Return the seconds that one completed poll takes, averaged, the unit's turnaround included."""
        return self._poll_s

    def scan_s(self, more_units: int = 0) -> float:
        """Return the seconds in which every online unit is polled once, with ``more_units`` more of them."""
        units = len(self.poll_order) + more_units
        return units * self._poll_s / max(self._poll_fraction, 0.05)
