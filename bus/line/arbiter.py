"""The arbiter of the wire, which decides whose request is next: commands first, then the schedule. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from bus.instants import Monotonic
from bus.line.commands.procedure import CommandRun, Priority, ProcedureResult
from bus.line.poll_schedule import MANY_UNITS, PollSchedule, Task, TaskKind
from bus.line.send import ExchangeResult, Send, SendAttempts
from bus.messages import Message
from bus.wire.commands import Nak, ReadParameterRequest, ReadStatusRequest, Request
from bus.wire.exchange import PendingResponses


class CommandQueue:
    """The queue of commands, by priority: writes, then reads, then slow reads in the gaps of the scan;
    commands of one priority in the order of their arrival.

    A command waits while an earlier one claims a unit that it claims too, and ends unsent when its deadline
    passes before its turn has come.
    """

    def __init__(self) -> None:
        self._all: list[CommandRun] = []

    def __iter__(self) -> Iterator[CommandRun]:
        return iter(tuple(self._all))

    def __len__(self) -> int:
        return len(self._all)

    def add(self, run: CommandRun) -> None:
        self._all.append(run)
        self._all.sort(key=lambda each: each.priority)

    def cancel(self, command_id: str) -> None:
        """Cancel a command: it ends unsent, or, once begun, at a point where nothing is half done."""
        for run in self._all:
            if run.id == command_id:
                run.context.cancelled = True
                if not run.begun:
                    run.end(ProcedureResult("not_sent", Message("canceled_before_sending")))

    def note_overdue(self, units: Iterable[int]) -> None:
        """Note that responses of these units came too late, while commands were under way."""
        for run in self._all:
            if run.begun:
                run.context.overdue.update(units)

    def next_request(
        self, now: Monotonic, pending_of: Callable[[int], PendingResponses], *, slow: bool = False
    ) -> tuple[CommandRun, Request] | None:
        """Return the next command that sends and its request; ``slow``: of those for gaps only, else of the
        others."""
        for run in self._all:
            if (run.priority is Priority.SLOW) != slow or run.result is not None:
                continue
            if self._may_run(run, now):
                request = run.next_request(now, pending_of)
                if request is not None:
                    if slow:
                        # Put it last: reads of several units in turn need no fence between them.
                        self._all.remove(run)
                        self._all.append(run)
                    return run, request
        return None

    def take_finished(self) -> list[CommandRun]:
        """Return the commands that have a result, and forget them."""
        finished = [run for run in self._all if run.result is not None]
        if finished:
            self._all = [run for run in self._all if run.result is None]
        return finished

    @property
    def write_waits(self) -> bool:
        """Whether a command that writes is waiting or under way, unless it only reads."""
        return any(
            run.priority is Priority.WRITE and run.result is None and not run.context.only_reads
            for run in self._all
        )

    @property
    def slow_waits(self) -> bool:
        """Whether a command that takes the gaps of the scan is waiting or under way."""
        return any(run.priority is Priority.SLOW for run in self._all)

    @property
    def group_changes(self) -> bool:
        """Whether a change of many units is under way, between whose frames nothing may come until it
        only reads."""
        return any(run.begun and len(run.units) > 1 and not run.context.only_reads for run in self._all)

    def moments(self) -> list[Monotonic]:
        """Return when each command resumes, or gives up waiting for its turn."""
        return [run.resume_at if run.begun else run.deadline for run in self._all]

    def _may_run(self, run: CommandRun, now: Monotonic) -> bool:
        if run.begun:
            return True
        for earlier in self._all:
            if earlier is run:
                return True
            if earlier.result is None and not earlier.units.isdisjoint(run.units):
                if now > run.deadline:
                    run.end(ProcedureResult("not_sent", Message("units_busy")))
                return False
        return True


COMMANDS_AT_A_STRETCH_S = 0.5
"""The longest series of operators' writes before one poll goes between, unless many units are being
changed."""
RESERVED_S = 0.015
"""The seconds of free wire in which an announced write passes through the app and onto its disk."""
ANNOUNCED_S = 0.25
"""The seconds after the announcement of a write in which a read may belong to its checks: the turn after such
a read is kept free for the write too."""
PACE = 0.8
"""The least part of the time on the wire that a read takes on a port that is faster than its baud rate."""
_TRIES = {TaskKind.FIRST: 1, TaskKind.PROBE: 1}


class NextRequest(NamedTuple):
    """The next use of the wire. ``run``: the command that sends; None for a request of the schedule."""

    request: Request
    run: CommandRun | None = None


class Arbiter:
    """The arbiter of one bus: call ``next_request``, then ``settle`` with how its exchange ended.

    ``pending_of``: the responses that a unit may still send late. ``exchange_s``: the seconds of a read on
    the wire.
    """

    def __init__(
        self,
        schedule: PollSchedule,
        pending_of: Callable[[int], PendingResponses],
        exchange_s: Callable[[Request], float],
    ) -> None:
        self.schedule = schedule
        self.commands = CommandQueue()
        self._pending_of = pending_of
        self._exchange_s = exchange_s
        self._routine: tuple[Task, SendAttempts] | None = None
        self._foreseen: tuple[Task, SendAttempts] | None = None
        self._routine_at = Monotonic(0.0)
        self._read_last = False
        self._not_before = Monotonic(0.0)
        self._reserved_at = Monotonic(0.0)
        self._reserved_until = Monotonic(0.0)

    def reserve(self, now: Monotonic) -> None:
        """Hold back reads of the schedule for a moment, because a write is about to be requested.

        For writes that never come, no more than one such moment between two reads is lost, and none while the
        schedule has had to wait long.
        """
        if self._routine_at >= self._reserved_at and now - self._routine_at < COMMANDS_AT_A_STRETCH_S:
            self._reserved_at = now
            self._reserved_until = now + RESERVED_S

    def next_request(self, now: Monotonic) -> NextRequest | None:
        """Return the request to send now, or None if nothing is due before one of ``moments``."""
        if len(self.commands) and self._leave_a_poll(now):
            if self._routine is None and (poll := self.schedule.next_poll(now)) is not None:
                self._routine = _routine(poll)
            return self._routine_request(now)
        return self._command_request(now) or self._routine_request(now)

    def foresee(self, under_way: NextRequest, now: Monotonic) -> NextRequest | None:
        """Return what follows ``under_way`` if its response is an ordinary one; None if that is not certain.

        An ordinary response to a poll does not change whose request is next. Only a new command does, and
        then the foreseen request follows the command.
        """
        if len(self.commands) or now < self._reserved_until or not self._is_poll(under_way):
            return None
        if self._foreseen is None:
            task = self.schedule.next(now)
            self._foreseen = _routine(task) if task is not None else None
        if self._foreseen is None or self._foreseen[0].unit == under_way.request.unit:
            return None
        task, attempts = self._foreseen
        request = attempts.next_request(now, self._pending_of(task.unit).moved_on())
        return NextRequest(request) if request is not None and request == attempts.send.request else None

    def follow(self, now: Monotonic) -> None:
        """Note that the foreseen request has left at ``now``, and that the turn before it is settled."""
        assert self._foreseen is not None
        self._routine, self._foreseen = self._foreseen, None
        self._pace(self._routine[1].send.request, now)

    def settle(self, turn: NextRequest, exchange: ExchangeResult) -> bool:
        """Take the result of ``turn``; return whether the request is repeated because nothing responded."""
        run = turn.run
        if run is not None:
            self._read_last = run.priority is Priority.READ or self._reads_back_many(run)
            if run.priority is Priority.SLOW:
                self.schedule.spent(Task(TaskKind.SLOW), exchange.began, exchange.ended, responded=True)
            again = run.settle(exchange, exchange.ended)
            is_announced = exchange.ended - self._reserved_at < ANNOUNCED_S
            if self._read_last and run.result is not None and is_announced:
                self._reserved_until = exchange.ended + RESERVED_S
            return again
        assert self._routine is not None
        return self._settle_routine(*self._routine, exchange)

    def moments(self) -> list[Monotonic]:
        """Return the moments at which something that is not due now may become due."""
        routine = self.schedule.moments(slow_waits=self.commands.slow_waits)
        return [self._not_before, self._reserved_until, *self.commands.moments(), *routine]

    # --- commands ------------------------------------------------------------------------------

    def _command_request(self, now: Monotonic, *, slow: bool = False) -> NextRequest | None:
        chosen = self.commands.next_request(now, self._pending_of, slow=slow)
        if chosen is None:
            return None
        run, request = chosen
        self._reserved_until = now
        return NextRequest(request, run)

    def _reads_back_many(self, run: CommandRun) -> bool:
        """Return whether ``run`` reads back so many units that readings would look overdue meanwhile."""
        return run.context.only_reads and len(self.schedule.poll_order) > MANY_UNITS

    def _leave_a_poll(self, now: Monotonic) -> bool:
        """Return whether a poll goes before the next command: reads of parameters, and those that read many
        units back, take at most every second turn, so that polling goes on beside them."""
        if self.commands.group_changes or len(self.schedule.poll_order) == 0:
            return False
        if self._routine is None and not self.schedule.poll_may_leave(now):
            return False
        if now - self._routine_at > COMMANDS_AT_A_STRETCH_S:
            return True
        free = now >= max(self._not_before, self._reserved_until)
        return self._read_last and free and not self.commands.write_waits

    # --- the schedule --------------------------------------------------------------------------

    def _is_poll(self, turn: NextRequest) -> bool:
        if turn.run is not None or self._routine is None:
            return False
        task, attempts = self._routine
        return (
            task.kind is TaskKind.POLL
            and turn.request == attempts.send.request
            and task.unit in self.schedule.poll_order
        )

    def _routine_request(self, now: Monotonic) -> NextRequest | None:
        if now < max(self._not_before, self._reserved_until):
            return None
        slow_waits = self.commands.slow_waits
        if self._routine is None:
            self._routine, self._foreseen = self._foreseen, None
        while self._routine is None:
            task = self.schedule.next(now, slow_waits=slow_waits)
            if task is None:
                return None
            if task.kind is not TaskKind.SLOW:
                self._routine = _routine(task)
                break
            turn = self._command_request(now, slow=True)
            if turn is not None:
                self._pace(turn.request, now)
                return turn
            slow_waits = False
        task, attempts = self._routine
        request = attempts.next_request(now, self._pending_of(task.unit))
        assert request is not None
        self._pace(request, now)
        return NextRequest(request)

    def _settle_routine(self, task: Task, attempts: SendAttempts, exchange: ExchangeResult) -> bool:
        # A poll at 300 baud takes longer than commands may delay the schedule: its wait counts from the end.
        self._routine_at = exchange.ended
        again = attempts.settle(exchange)
        self.schedule.spent(task, exchange.began, exchange.ended, responded=exchange.reply is not None)
        result = attempts.result
        if result is None:
            return again
        self._routine = None
        if task.kind is TaskKind.FIRST and result.reply is None:
            self.schedule.stopped_responding(task.unit, exchange.ended)
        if task.kind is TaskKind.PARAMETER and task.unit in self.schedule.poll_order:
            if result.reply is None:
                self.schedule.parameters.was_not_read(task.unit, task.number)
            else:
                available = not isinstance(result.reply, Nak)
                self.schedule.parameters.was_read(task.unit, task.number, available=available)
        return False

    def _pace(self, request: Request, now: Monotonic) -> None:
        self._read_last = False
        self._routine_at = now
        self._not_before = now + PACE * self._exchange_s(request)


def _routine(task: Task) -> tuple[Task, SendAttempts]:
    tries = _TRIES.get(task.kind, 0)
    if task.kind is TaskKind.PARAMETER:
        return task, SendAttempts(Send(ReadParameterRequest(task.unit, task.number), max_attempts=tries))
    return task, SendAttempts(Send(ReadStatusRequest(task.unit), max_attempts=tries))
