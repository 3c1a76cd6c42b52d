"""Records the changes of a bus in the event log, in order and within a budget, and never holds up who reports
them: what cannot be written now waits."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import structlog

from app.audit.events.budget import BURST, EventBudget, Summary
from app.audit.log import EventLog
from app.errors import StoreError
from app.live.changes import LineEvent
from bus.instants import UnixTime, monotonic_now
from bus.messages import Message

RETRY_AFTER_S = 1.0
FEW = 6
"""How often a port or a worker comes and goes before that is summed up."""
MAX_WAITING = 10_000
"""Changes kept in memory while the log cannot be written; then the oldest are left out, and counted."""
DUE_EVERY_S = 1.0
"""How often it is looked for summaries."""

log = structlog.get_logger()


class ChangeRecorder:
    """Of one bus; of the site without ``bus``."""

    def __init__(self, events: EventLog, bus: str | None = None) -> None:
        self._events = events
        self._bus = bus
        self._monotonic = monotonic_now
        self._budget: EventBudget[LineEvent] = EventBudget()
        self._queue: asyncio.Queue[LineEvent] = asyncio.Queue()
        self._left_out = 0

    def note(self, change: LineEvent) -> None:
        """Record this soon, on its own or in a summary."""
        key = (change.unit, change.kind, change.series)
        burst = 1 if change.count else FEW if change.kind in ("bus", "worker") else BURST
        if self._budget.admits(key, change, self._monotonic(), burst=burst, count=change.count or 1):
            self._put(change)

    async def follow(self) -> None:
        """Write what was noted into the events, in order, until cancelled."""
        fault = ""
        while True:
            self._note_due()
            try:
                async with asyncio.timeout(DUE_EVERY_S):
                    change = await self._queue.get()
            except TimeoutError:
                continue
            while why := await self._write(change):
                if why != fault:
                    log.error("events wait", error=why, bus=self._bus)
                fault = why
                await asyncio.sleep(RETRY_AFTER_S)
            self._queue.task_done()
            self._note_left_out(change.at)

    async def recorded(self) -> None:
        """Wait until everything that was noted is in the events, also what was kept for a summary."""
        self._note_due(everything=True)
        await self._queue.join()

    async def _write(self, change: LineEvent) -> str:
        """Returns why it could not be written; empty when it is on disk."""
        try:
            await self._events.record(
                kind=change.kind,
                bus=self._bus,
                unit=change.unit,
                what=change.what,
                old=change.old,
                new=str(change.count) if change.count else change.new,
                message=change.message or "",
                at=change.at,
            )
        except StoreError as error:
            return str(error)
        return ""

    def _note_due(self, *, everything: bool = False) -> None:
        for summary in self._budget.due(self._monotonic(), everything=everything):
            self._put(_summed_up(summary))

    def _put(self, change: LineEvent) -> None:
        if self._queue.qsize() >= MAX_WAITING:
            self._queue.get_nowait()
            self._queue.task_done()
            self._left_out += 1
        self._queue.put_nowait(change)

    def _note_left_out(self, at: UnixTime) -> None:
        """After a write that succeeded: what had no place until then, as one event."""
        if self._left_out:
            what = Message.of("event_changes_left_out", n=self._left_out)
            self._left_out = 0
            self._queue.put_nowait(LineEvent("audit", None, at, what, "", ""))


def _summed_up(summary: Summary[LineEvent]) -> LineEvent:
    if summary.last.count:
        return replace(summary.last, count=summary.count)
    if summary.count == 1:
        return summary.last
    seconds = round(summary.seconds)
    return replace(summary.last, message=Message.of("events_summed_up", n=summary.count, seconds=seconds))
