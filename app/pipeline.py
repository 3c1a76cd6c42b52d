"""Where one update goes, in order: what is now, what was then, what is worth an entry.

The live state comes first, and with it the browsers; history and events never hold it up.
"""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import structlog

from app.audit.budget import BURST, EventBudget, Summary
from app.audit.log import EventLog
from app.errors import StoreError
from app.live.changes import Change, Changes
from app.live.state.live_state import LiveState
from bus.contract import BusLink, Hello, ParameterValue, Reading, Snapshot, UnitLink, Update
from bus.messages import Message

AGAIN_AFTER_S = 1.0
KEPT = (Reading, ParameterValue, UnitLink, BusLink)
"""What belongs to history; what is of the moment only does not wait in its queue."""
FEW = 6
"""How often a port or a worker comes and goes before that is summed up."""
DUE_EVERY_S = 1.0
"""How often it is looked for summaries."""
IMPLAUSIBLE = "their time cannot be, or their unit is not configured; check the worker's clock and its units"

log = structlog.get_logger()


class Keeper(Protocol):
    """What keeps readings: the history, never waiting."""

    def append(self, bus: str, updates: Sequence[Update]) -> None:
        """Take in what a worker reported."""

    def on_clock_step(self, subscriber: Callable[[float, float], None]) -> None:
        """Call ``subscriber`` when the app's own clock was stepped: by how many seconds, and when."""

    def on_damage(self, subscriber: Callable[[str, float], None]) -> None:
        """Call ``subscriber`` when something stored cannot be read: what, and when that was found."""


class Pipeline:
    """One for the app. Everything here is called on the event loop, without waiting."""

    def __init__(
        self,
        live: LiveState,
        history: Keeper,
        events: EventLog,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._live = live
        self._monotonic = monotonic
        self._budgets: defaultdict[str | None, EventBudget[Change]] = defaultdict(EventBudget)
        self._history = history
        self._events = events
        self._changes = {name: Changes(bus.settings) for name, bus in live.buses.items()}
        self._to_record: asyncio.Queue[tuple[str | None, Change]] = asyncio.Queue()
        history.on_clock_step(partial(self.clock_stepped, None))
        history.on_damage(self.history_damaged)

    def snapshot(self, bus: str, snapshot: Snapshot, software: str) -> None:
        """A worker's whole state: it is now. History had its readings, or gets them as backlog; the
        parameters that scale them and the states of the links may be news to it."""
        updates = self._live.worker_came(bus, snapshot, software)
        self._history.append(bus, [update for update in updates if not isinstance(update, Reading)])

    def batch(self, bus: str, updates: Sequence[Update], *, live: bool) -> None:
        """Updates in order. Those kept while the app was away belong to history and events only."""
        if live:
            self._live.apply(bus, updates)
        if kept := [update for update in updates if isinstance(update, KEPT)]:
            self._history.append(bus, kept)
        seen = self._changes[bus]
        for update in updates:
            for change in seen.see(update):
                self._note(bus, change)

    def units_of(self, bus: str) -> Collection[int]:
        """The addresses of the units that are configured for this bus."""
        return self._live.buses[bus].units.keys()

    def port_is_open(self, bus: str) -> bool:
        """As the worker of this bus said last."""
        return self._live.buses[bus].link.link == "open"

    def worker_came(self, hello: Hello, at: float, *, again: bool) -> None:
        """A worker said hello: ``again`` the one that this app knew, else one that was started."""
        what = f"bus worker {'is back' if again else 'started'}, port {hello.port}"
        self._note(hello.bus, Change("worker", None, at, what, "", "connected"))

    def worker_refused(self, bus: str, at: float, holder: str, refused: str, reason: str) -> None:
        """A worker's hello was refused. ``holder`` and ``refused``: the tokens and their addresses."""
        what = "bus worker refused"
        self._note(bus, Change("worker", None, at, what, holder, refused, reason, series=what))

    def updates_refused(self, bus: str, at: float, count: int) -> None:
        """Updates of a worker were not taken in: their time cannot be, or their unit is not configured."""
        what = "updates of the bus worker refused"
        self._note(bus, Change("worker", None, at, what, "", str(count), IMPLAUSIBLE, series=what))

    def worker_went(self, bus: str, at: float, cause: Message) -> None:
        """A worker's connection ended."""
        self._live.worker_went(bus, at, cause)
        self._note(bus, Change("worker", None, at, str(cause), "connected", "gone"))

    def clock_stepped(self, bus: str | None, step_s: float, at: float) -> None:
        """A clock was set: a worker's, or with no bus the app's own."""
        whose = "the app" if bus is None else "the bus worker"
        self._note(bus, Change("clock", None, at, f"clock of {whose} stepped by {step_s:+.3f} s", "", ""))

    def history_damaged(self, what: str, at: float) -> None:
        """Something that was kept could not be read."""
        self._note(None, Change("server", None, at, what, "", ""))

    async def record(self) -> None:
        """Write what was noted into the events, in order, for ever. What cannot be written now waits."""
        said = ""
        while True:
            self._note_due()
            try:
                async with asyncio.timeout(DUE_EVERY_S):
                    bus, change = await self._to_record.get()
            except TimeoutError:
                continue
            while fault := await self._write_down(bus, change):
                if fault != said:
                    log.error("events wait", error=fault)
                said = fault
                await asyncio.sleep(AGAIN_AFTER_S)
            self._to_record.task_done()

    async def _write_down(self, bus: str | None, change: Change) -> str:
        """Gives why it could not be; empty when it is on disk."""
        try:
            await self._events.record(
                kind=change.kind,
                bus=bus,
                unit=change.unit,
                what=change.what,
                old=change.old,
                new=change.new,
                message=change.message,
                at=change.at,
            )
        except StoreError as error:
            return str(error)
        return ""

    async def recorded(self) -> None:
        """Wait until everything that was noted is in the events, also what was kept for a summary."""
        self._note_due(everything=True)
        await self._to_record.join()

    def _note(self, bus: str | None, change: Change) -> None:
        key = (change.unit, change.kind, change.series)
        burst = FEW if change.kind in ("bus", "worker") else BURST
        if self._budgets[bus].admits(key, change, self._monotonic(), burst=burst):
            self._to_record.put_nowait((bus, change))

    def _note_due(self, *, everything: bool = False) -> None:
        for bus, budget in self._budgets.items():
            for summary in budget.due(self._monotonic(), everything=everything):
                self._to_record.put_nowait((bus, _summed_up(summary)))


def _summed_up(summary: Summary[Change]) -> Change:
    if summary.count == 1:
        return summary.last
    said = f"the last of {summary.count} events within {summary.seconds:.0f} s; the others are not recorded"
    return replace(summary.last, message=said)
