"""Refused sign-ins as events, however many strangers cause: some of them one by one, the rest as counts."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

from app.audit.budget import EventBudget, Summary
from app.audit.kinds import Kind
from app.audit.log import EventLog

DUE_EVERY_S = 5.0


@dataclass(frozen=True, slots=True)
class _Refusal:
    kind: Kind
    what: str
    who: str
    address: str


class Refusals:
    """Run :meth:`follow`, and call :meth:`record_due` with ``everything`` at the end."""

    def __init__(self, events: EventLog, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._events = events
        self._monotonic = monotonic
        self._budget: EventBudget[_Refusal] = EventBudget()

    async def note(self, kind: Kind, what: str, who: str, address: str) -> None:
        """Somebody at ``address`` was refused as ``who``."""
        refusal = _Refusal(kind, what, who, address)
        if self._budget.admits((kind, who), refusal, self._monotonic()):
            await self._record(refusal)

    async def follow(self) -> None:
        """Record the counts as they fall due, until cancelled."""
        while True:
            await asyncio.sleep(DUE_EVERY_S)
            await self.record_due()

    async def record_due(self, *, everything: bool = False) -> None:
        """Record what was only counted, where it is time."""
        for summary in self._budget.due(self._monotonic(), everything=everything):
            await self._record(summary.last, _count(summary))

    async def _record(self, refusal: _Refusal, message: str = "") -> None:
        await self._events.record(
            kind=refusal.kind, what=refusal.what, who=refusal.who, origin=refusal.address, message=message
        )


def _count(summary: Summary[_Refusal]) -> str:
    if summary.count == 1:
        return ""
    return f"the last of {summary.count} events within {summary.seconds:.0f} s; the others are not recorded"
