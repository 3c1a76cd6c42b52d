"""Where one update goes, in order: what is now, what was then, what is worth an entry.

The live state comes first, and with it the browsers; history and events never hold it up.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Protocol

import structlog

from app.audit.log import EventLog
from app.errors import StoreError
from app.live.changes import Change, Changes
from app.live.state import LiveState
from bus.contract import Hello, Reading, Snapshot, Update

AGAIN_AFTER_S = 1.0

log = structlog.get_logger()


class Keeper(Protocol):
    """What keeps readings: the history, never waiting."""

    def append(self, bus: str, updates: Sequence[Update]) -> None:
        """Take in what a worker reported."""


class Pipeline:
    """One for the app. Everything here is called on the event loop, without waiting."""

    def __init__(self, live: LiveState, history: Keeper, events: EventLog) -> None:
        self._live = live
        self._history = history
        self._events = events
        self._changes = {name: Changes(bus.settings) for name, bus in live.buses.items()}
        self._to_record: asyncio.Queue[tuple[str | None, Change]] = asyncio.Queue()

    def snapshot(self, bus: str, snapshot: Snapshot, software: str) -> None:
        """A worker's whole state: it is now. History had its readings, or gets them as backlog; the
        parameters that scale them and the states of the links may be news to it."""
        updates = self._live.worker_came(bus, snapshot, software)
        self._history.append(bus, [update for update in updates if not isinstance(update, Reading)])

    def batch(self, bus: str, updates: Sequence[Update], *, live: bool) -> None:
        """Updates in order. Those kept while the app was away belong to history and events only."""
        if live:
            self._live.apply(bus, updates)
        self._history.append(bus, updates)
        seen = self._changes[bus]
        for update in updates:
            for change in seen.see(update):
                self._note(bus, change)

    def port_is_open(self, bus: str) -> bool:
        """As the worker of this bus said last."""
        return self._live.buses[bus].link.link == "open"

    def worker_came(self, hello: Hello, at: float, *, again: bool) -> None:
        """A worker said hello: ``again`` the one that this app knew, else one that was started."""
        what = f"bus worker {'is back' if again else 'started'}, port {hello.port}"
        self._note(hello.bus, Change("worker", None, at, what, "", "connected"))

    def worker_refused(self, bus: str, at: float, holder: str, refused: str, reason: str) -> None:
        """A worker's hello was refused. ``holder`` and ``refused``: the tokens and their addresses."""
        self._note(bus, Change("worker", None, at, "bus worker refused", holder, refused, reason))

    def worker_went(self, bus: str, at: float, cause: str) -> None:
        """A worker's connection ended."""
        self._live.worker_went(bus, at, cause)
        self._note(bus, Change("worker", None, at, cause, "connected", "gone"))

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
            bus, change = await self._to_record.get()
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
        """Wait until everything that was noted is in the events."""
        await self._to_record.join()

    def _note(self, bus: str | None, change: Change) -> None:
        self._to_record.put_nowait((bus, change))
