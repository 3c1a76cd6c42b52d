"""Whose request is next: operators' errands first, then the schedule. No clock, no port.

What follows a poll is known before its answer is complete (``foresee``): an ordinary answer changes nothing
about who is next. Only an errand does, and then what was foreseen has its turn after it.
"""

from __future__ import annotations

from collections.abc import Callable

from bus.line.commands.command_run import Claim, Errand
from bus.line.commands.procedure import Ask
from bus.line.exchange.attempts import Asking, Heard
from bus.line.schedule.command_queue import Errands
from bus.line.schedule.poll_schedule import Kind, Schedule, Task
from bus.wire.commands import Nak, ReadParameter, ReadStatus, Request
from bus.wire.fence import Doubt

ERRANDS_AT_A_STRETCH_S = 0.5
"""Operators' writes without end leave one poll in this time, unless a change of many units is under way."""
RESERVED_S = 0.015
"""A turn is left free so long for a write that is announced: its way through the app and onto its disk."""
PACE = 0.8
"""On a port faster than its baud rate a round still takes this part of the time it would on the wire."""
_TRIES = {Kind.FIRST: 1, Kind.PROBE: 1}


class Turns:
    """``next_request``, then ``settle`` with what was heard.

    ``doubt_of``: what a unit may still answer late. ``exchange_s``: what a read takes on the wire.
    """

    def __init__(
        self, schedule: Schedule, doubt_of: Callable[[int], Doubt], exchange_s: Callable[[Request], float]
    ) -> None:
        self.schedule = schedule
        self.errands = Errands()
        self.owner: Errand | None = None
        """Whose request is under way; None: the schedule's."""
        self._doubt_of = doubt_of
        self._exchange_s = exchange_s
        self._routine: tuple[Task, Asking] | None = None
        self._foreseen: tuple[Task, Asking] | None = None
        self._routine_at = 0.0
        self._read_last = False
        self._not_before = 0.0
        self._reserved_at = 0.0
        self._reserved_until = 0.0

    def reserve(self, now: float) -> None:
        """No read of the schedule leaves for a moment, because a write is about to be asked for.

        For writes that never come, no more than one such moment between two reads is lost, and none while
        the schedule has had to wait long.
        """
        if self._routine_at >= self._reserved_at and now - self._routine_at < ERRANDS_AT_A_STRETCH_S:
            self._reserved_at = now
            self._reserved_until = now + RESERVED_S

    def next_request(self, now: float) -> Request | None:
        """What is sent now; None: nothing before one of ``moments``."""
        if len(self.errands) and self._leave_a_poll(now):
            if self._routine is None and (poll := self.schedule.next_poll()) is not None:
                self._routine = _routine(poll)
            return self._routine_request(now)
        return self._errands_request(now) or self._routine_request(now)

    def foresee(self, under_way: Request, now: float) -> Request | None:
        """What follows ``under_way`` if its answer is an ordinary one; None where that is not known."""
        if len(self.errands) or now < self._reserved_until or not self._is_an_ordinary_poll(under_way):
            return None
        if self._foreseen is None:
            task = self.schedule.next(now)
            self._foreseen = _routine(task) if task is not None else None
        if self._foreseen is None or self._foreseen[0].unit == under_way.unit:
            return None
        task, asking = self._foreseen
        request = asking.next_request(now, self._doubt_of(task.unit).moved_on())
        return request if request == asking.ask.request else None

    def followed(self, now: float) -> Request:
        """What was foreseen has left at ``now``."""
        assert self._foreseen is not None
        (task, asking), self._foreseen = self._foreseen, None
        self._routine = task, asking
        self._pace(asking.ask.request, now)
        return asking.ask.request

    def settle(self, heard: Heard, began: float, ended: float) -> bool:
        """The exchange under way is over; whether it is tried again, as nobody answered."""
        errand, self.owner = self.owner, None
        if errand is not None:
            self._read_last = errand.claim is Claim.READ
            if errand.claim is Claim.SLOW:
                self.schedule.spent(Task(Kind.SLOW), began, ended, answered=True)
            return errand.settle(heard, ended)
        if self._routine is not None:
            return self._settle_routine(*self._routine, heard, began, ended)
        return False

    def drop_routine(self) -> None:
        """The port is gone, and the schedule's read with it."""
        self._routine = None

    def moments(self) -> list[float]:
        """When something may become due that is not now."""
        probe = self.schedule.wake_at()
        moments = [self._not_before, self._reserved_until, *self.errands.moments()]
        return moments if probe is None else [probe, *moments]

    # --- errands -------------------------------------------------------------------------------

    def _errands_request(self, now: float, *, slow: bool = False) -> Request | None:
        chosen = self.errands.next_request(now, self._doubt_of, slow=slow)
        if chosen is None:
            return None
        self.owner, request = chosen
        self._reserved_until = now
        return request

    def _leave_a_poll(self, now: float) -> bool:
        """A look at parameters takes every second turn at most: who reads many must not blind the others."""
        if self.errands.whole_line_changes or len(self.schedule.round) == 0:
            return False
        if now - self._routine_at > ERRANDS_AT_A_STRETCH_S:
            return True
        free = now >= max(self._not_before, self._reserved_until)
        return self._read_last and free and not self.errands.write_waits

    # --- the schedule --------------------------------------------------------------------------

    def _is_an_ordinary_poll(self, request: Request) -> bool:
        if self.owner is not None or self._routine is None:
            return False
        task, asking = self._routine
        return task.kind is Kind.POLL and request == asking.ask.request and task.unit in self.schedule.round

    def _routine_request(self, now: float) -> Request | None:
        if now < max(self._not_before, self._reserved_until):
            return None
        slow_waits = self.errands.slow_waits
        while self._routine is None:
            if self._foreseen is not None:
                self._routine, self._foreseen = self._foreseen, None
                break
            task = self.schedule.next(now, slow_waits=slow_waits)
            if task is None:
                return None
            if task.kind is not Kind.SLOW:
                self._routine = _routine(task)
                break
            request = self._errands_request(now, slow=True)
            if request is not None:
                self._pace(request, now)
                return request
            slow_waits = False
        task, asking = self._routine
        request = asking.next_request(now, self._doubt_of(task.unit))
        assert request is not None
        self._pace(request, now)
        return request

    def _settle_routine(self, task: Task, asking: Asking, heard: Heard, began: float, ended: float) -> bool:
        again = asking.settle(heard)
        self.schedule.spent(task, began, ended, answered=heard.reply is not None)
        answer = asking.answer
        if answer is None:
            return again
        self._routine = None
        if task.kind is Kind.FIRST and answer.reply is None:
            self.schedule.fell_silent(task.unit, ended)
        if task.kind is Kind.PARAMETER and task.unit in self.schedule.round:
            if answer.reply is None:
                self.schedule.gaps.was_not_read(task.unit, task.number)
            else:
                available = not isinstance(answer.reply, Nak)
                self.schedule.gaps.was_read(task.unit, task.number, available=available)
        return False

    def _pace(self, request: Request, now: float) -> None:
        self._read_last = False
        self._routine_at = now
        self._not_before = now + PACE * self._exchange_s(request)


def _routine(task: Task) -> tuple[Task, Asking]:
    tries = _TRIES.get(task.kind, 0)
    if task.kind is Kind.PARAMETER:
        return task, Asking(Ask(ReadParameter(task.unit, task.number), most_tries=tries))
    return task, Asking(Ask(ReadStatus(task.unit), most_tries=tries))
