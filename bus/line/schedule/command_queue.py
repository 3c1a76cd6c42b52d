"""All commands that wait or are under way: whose turn it is, and who must not be mixed with whom. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bus.contract import Result
from bus.line.commands.command_run import Claim, Errand
from bus.messages import Message
from bus.wire.commands import Request
from bus.wire.fence import Doubt


class Errands:
    """Writes before reads before what is slow; within a claim the first come first, but for the slow.

    An errand waits while an earlier one claims a unit that it claims too, and ends by itself when its time
    is over before its turn has come.
    """

    def __init__(self) -> None:
        self._all: list[Errand] = []

    def __iter__(self) -> Iterator[Errand]:
        return iter(tuple(self._all))

    def __len__(self) -> int:
        return len(self._all)

    def add(self, errand: Errand) -> None:
        """Let it have its turn."""
        self._all.append(errand)
        self._all.sort(key=lambda each: each.claim)

    def cancel(self, command_id: str) -> None:
        """Give one up where nothing is half done."""
        for errand in self._all:
            if errand.id == command_id:
                errand.wish.cancelled = True
                if not errand.begun:
                    errand.end(_never_begun(Message("canceled_before_sending")))

    def next_request(
        self, now: float, doubt_of: Callable[[int], Doubt], *, slow: bool = False
    ) -> tuple[Errand, Request] | None:
        """Who sends what now; ``slow``: of those that take the gaps only, else of all the others."""
        for errand in self._all:
            if (errand.claim is Claim.SLOW) != slow or errand.result is not None:
                continue
            if self._may_run(errand, now):
                request = errand.next_request(now, doubt_of)
                if request is not None:
                    if slow:
                        self._take_turns(errand)
                    return errand, request
        return None

    def _take_turns(self, errand: Errand) -> None:
        """Slow ones go in turn: reads of several units then follow each other without a fence between."""
        self._all.remove(errand)
        self._all.append(errand)

    def take_finished(self) -> list[Errand]:
        """Those that have a result; they are forgotten here."""
        finished = [errand for errand in self._all if errand.result is not None]
        if finished:
            self._all = [errand for errand in self._all if errand.result is None]
        return finished

    @property
    def write_waits(self) -> bool:
        """Whether anything would write."""
        return any(errand.claim is Claim.WRITE and errand.result is None for errand in self._all)

    @property
    def slow_waits(self) -> bool:
        """Whether anything would use a gap."""
        return any(errand.claim is Claim.SLOW for errand in self._all)

    @property
    def whole_line_changes(self) -> bool:
        """Whether a change of many units is under way, between whose frames nothing may come."""
        return any(errand.begun and len(errand.units) > 1 for errand in self._all)

    def moments(self) -> list[float]:
        """When one of them resumes, or gives up waiting for its turn."""
        return [errand.resume_at if errand.begun else errand.deadline for errand in self._all]

    def _may_run(self, errand: Errand, now: float) -> bool:
        if errand.begun:
            return True
        for earlier in self._all:
            if earlier is errand:
                return True
            if earlier.result is None and earlier.conflicts_with(errand):
                if now > errand.deadline:
                    errand.end(_never_begun(Message("units_busy")))
                return False
        return True


def _never_begun(message: Message) -> Result:
    return Result(id="", at=0.0, outcome="not_sent", message=message)
