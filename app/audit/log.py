"""The event log as the rest of the app writes it."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any

import structlog

from app.audit import search, store
from app.audit.chain import Verdict
from app.audit.kinds import Kind
from app.audit.repeated import RepeatedEvents
from app.audit.store import Filter
from app.database import Database
from app.errors import StoreError
from bus.contract import Frame, Outcome

log = structlog.get_logger()

Event = dict[str, Any]
"""One event with its fate, as `app.audit.store.select` gives it."""
Subscriber = Callable[[Event], None]
Also = Callable[[sqlite3.Connection], None]
"""What else is written in the transaction of an event."""

CHUNK = 1000
INDEX_PAUSE_S = 0.05
"""Between two transactions of the index, in which commands are written down."""
ENDED_BEFORE = "the server stopped before the fate was known"


def _nothing(_: sqlite3.Connection) -> None:
    """Nothing else."""


class EventLog:
    """Append-only. Whatever returns from here is on disk."""

    def __init__(self, database: Database, clock: Callable[[], float] = time.time) -> None:
        self.repeated = RepeatedEvents(self.record, clock)
        self._database = database
        self._clock = clock
        self._subscribers: list[Subscriber] = []

    def subscribe(self, subscriber: Subscriber) -> Callable[[], None]:
        """Hear of each event, and of a command again with its fate. Returns what ends it."""
        self._subscribers.append(subscriber)
        return lambda: self._subscribers.remove(subscriber)

    async def intend(
        self,
        *,
        kind: Kind = "command",
        who: str,
        origin: str,
        bus: str,
        unit: int | None,
        what: str,
        old: str | None = None,
        new: str | None = None,
        old_raw: int | None = None,
        new_raw: int | None = None,
    ) -> int:
        """What is about to be asked, on disk before it is. Returns the event's number for `conclude`."""
        said = {"bus": bus, "unit": unit, "old": old, "new": new, "old_raw": old_raw, "new_raw": new_raw}
        return await self._append(kind=kind, who=who, origin=origin, what=what, **said)

    async def intend_together(self, intents: Sequence[Mapping[str, Any]], also: Also = _nothing) -> list[int]:
        """Several intents (each with the words of `intend`) in one transaction, and ``also`` what belongs to
        them; their numbers in order."""
        return await self._append_all([self._entry(kind="command", **intent) for intent in intents], also)

    async def conclude_together(self, fates: Mapping[int, tuple[Outcome, str]]) -> None:
        """By event number the outcome and message of each, in one transaction."""
        entries = [
            self._entry(kind="fate", about=event, outcome=outcome, message=message)
            for event, (outcome, message) in fates.items()
        ]
        await self._write_all(entries)
        for event in fates:
            await self._tell(event)

    async def conclude(
        self,
        event: int,
        outcome: Outcome,
        message: str = "",
        frames: Sequence[Frame] = (),
        also: Also = _nothing,
    ) -> None:
        """The one fate of what was intended; ``frames`` carried it. ``also``: in the same transaction."""
        shown = [_frame(frame) for frame in frames]
        entry = self._entry(kind="fate", about=event, outcome=outcome, message=message, frames=shown)
        await self._write_all([entry], also)
        await self._tell(event)

    async def record(
        self,
        *,
        kind: Kind,
        what: str,
        who: str = "",
        origin: str = "",
        bus: str | None = None,
        unit: int | None = None,
        old: str | None = None,
        new: str | None = None,
        old_raw: int | None = None,
        new_raw: int | None = None,
        outcome: str | None = None,
        message: str = "",
        at: float | None = None,
        count: int = 1,
    ) -> int:
        """Something that happened, whole; ``at`` when, if not just now, and ``count`` how often. Returns the
        event's number."""
        if count > 1:
            message = f"{count} times; {message}" if message else f"{count} times"
        said: dict[str, Any] = {"bus": bus, "unit": unit}
        said |= {"old": old, "new": new, "old_raw": old_raw, "new_raw": new_raw}
        words = {"what": what, "outcome": outcome, "message": message}
        if at is not None:
            said["time"] = at
        return await self._append(kind=kind, who=who, origin=origin, **words, **said)

    async def count(
        self, kind: Kind, what: str, *, who: str = "", origin: str = "", message: str = ""
    ) -> None:
        """Something that a stranger can cause as often as they like: see `RepeatedEvents`."""
        await self.repeated.count(kind, what, who=who, origin=origin, message=message)

    async def close_open_intents(self) -> int:
        """At start: what was open when the server ended is unverified. Returns how many there were."""
        left = await self._database.read(store.open_intents)
        for intent in left:
            await self.conclude(intent["id"], "unverified", ENDED_BEFORE)
        return len(left)

    async def page(self, wanted: Filter, limit: int) -> tuple[list[Event], int | None]:
        """Events newest first, and the number to ask on from (None at the end)."""
        found = await self._database.read_costly(
            lambda connection: store.select(connection, wanted, limit + 1)
        )
        return found[:limit], found[limit - 1]["id"] if len(found) > limit else None

    async def every(self, wanted: Filter) -> AsyncIterator[list[Event]]:
        """All of them newest first, in pieces, however many they are."""
        while True:
            chunk, after = await self.page(wanted, CHUNK)
            yield chunk
            if after is None:
                return
            wanted = Filter(**{**vars(wanted), "before": after})

    async def kinds(self) -> list[str]:
        """Every kind there is an event of."""
        return await self._database.read_costly(store.kinds)

    async def index(self) -> None:
        """Make every event searchable by the index: those to come, then those that there are."""
        try:
            await self._database.write(search.prepare)
            is_more = True
            while is_more:
                is_more = await self._database.write(search.index_more)
                await asyncio.sleep(INDEX_PAUSE_S)
        except StoreError as error:
            log.warning("events are searched without an index", why=str(error))

    async def prove(self) -> Verdict:
        """Whether the log is whole."""
        return await self._database.read(store.prove)

    async def _append(self, **said: Any) -> int:
        entry = self._entry(**said)
        return (await self._append_all([entry]))[0]

    async def _append_all(self, entries: Sequence[Event], also: Also = _nothing) -> list[int]:
        numbers = await self._write_all(entries, also)
        for number, entry in zip(numbers, entries, strict=True):
            self._say({**entry, "id": number, "concluded_at": None})
        return numbers

    async def _write_all(self, entries: Sequence[Event], also: Also = _nothing) -> list[int]:
        def append(connection: sqlite3.Connection) -> list[int]:
            also(connection)
            return [store.append(connection, entry) for entry in entries]

        return await self._database.write(append)

    def _entry(self, **said: Any) -> dict[str, Any]:
        nothing = dict.fromkeys(("about", "bus", "unit", "old", "new", "old_raw", "new_raw", "outcome"))
        words = {"who": "", "origin": "", "what": "", "message": ""}
        frames = json.dumps(said.pop("frames", []), separators=(",", ":"), ensure_ascii=False)
        return {**nothing, **words, "time": self._clock(), **said, "frames": frames}

    async def _tell(self, number: int) -> None:
        if not self._subscribers:
            return
        event = await self._database.read(lambda connection: store.one(connection, number))
        if event is not None:
            self._say(event)

    def _say(self, event: Event) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:
                log.exception("subscriber of events failed", event_id=event["id"])


def _frame(frame: Frame) -> dict[str, Any]:
    return {
        "at": frame.at,
        "direction": frame.direction,
        "data": frame.data.hex(" ").upper(),
        "meaning": frame.meaning,
    }
