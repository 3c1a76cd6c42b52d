"""All commands that wait or are under way: which is next, and which must not be mixed. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from bus.instants import Monotonic
from bus.line.commands.command_run import CommandRun, Priority
from bus.line.commands.procedure import ProcedureResult
from bus.messages import Message
from bus.wire.commands import Request
from bus.wire.fence import PendingResponses


class CommandQueue:
    """Writes before reads before what is slow; within a claim the first come first, but for the slow.

    A command waits while an earlier one claims a unit that it claims too, and ends unsent when its time
    is over before its turn has come.
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
        """Give one up where nothing is half done."""
        for run in self._all:
            if run.id == command_id:
                run.context.cancelled = True
                if not run.begun:
                    run.end(ProcedureResult("not_sent", Message("canceled_before_sending")))

    def note_overdue(self, units: Iterable[int]) -> None:
        """Responses of these units came too late, while commands were under way."""
        for run in self._all:
            if run.begun:
                run.context.overdue.update(units)

    def next_request(
        self, now: Monotonic, pending_of: Callable[[int], PendingResponses], *, slow: bool = False
    ) -> tuple[CommandRun, Request] | None:
        """Who sends what now; ``slow``: of those that take the gaps only, else of all the others."""
        for run in self._all:
            if (run.priority is Priority.SLOW) != slow or run.result is not None:
                continue
            if self._may_run(run, now):
                request = run.next_request(now, pending_of)
                if request is not None:
                    if slow:
                        # In turn: reads of several units then follow each other without a fence between.
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
        """Whether anything would write."""
        return any(run.priority is Priority.WRITE and run.result is None for run in self._all)

    @property
    def slow_waits(self) -> bool:
        """Whether anything would use a gap."""
        return any(run.priority is Priority.SLOW for run in self._all)

    @property
    def group_changes(self) -> bool:
        """Whether a change of many units is under way, between whose frames nothing may come."""
        return any(run.begun and len(run.units) > 1 for run in self._all)

    def moments(self) -> list[Monotonic]:
        """When one of them resumes, or gives up waiting for its turn."""
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
