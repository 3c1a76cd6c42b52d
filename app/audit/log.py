"""Writes, reads and verifies the event log."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Required, TypedDict, Unpack

import structlog

from app.audit.archive.cuts import newest_cut
from app.audit.events import appending, store
from app.audit.events.entry import Event as Event
from app.audit.events.entry import is_moment, new_entry, readable
from app.audit.events.kinds import EventKind
from app.audit.events.repeated import RepeatedEvents
from app.audit.events.store import Filter
from app.audit.proof.anchor import read_key_anchor
from app.audit.proof.chain import Head, newest_of
from app.audit.proof.keyring import KeyRing
from app.audit.proof.keys import Keys, passing_keys
from app.audit.proof.walk import AuditVerification, Walk
from app.database import Database, StoreConnection
from app.errors import StoreUnavailableError
from bus.contract import Frame, Outcome
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

log = structlog.get_logger()

EventSubscriber = Callable[[Event], None]
Also = Callable[[StoreConnection], object]
"""Writes something else in the transaction of an event."""

CHUNK = 1000
ENDED_BEFORE = Message("server_stopped")


class EventFields(TypedDict, total=False):
    """The fields that an event may state."""

    what: Required[str | Message]
    who: str | Message
    origin: str | Message
    bus: str | None
    unit: int | None
    old: str | Message | None
    new: str | Message | None
    old_raw: int | None
    new_raw: int | None
    outcome: str | None
    message: str | Message


NO_TEXTS: Mapping[Any, Any] = MappingProxyType({})


class EventLog:
    """Append-only. Whatever returns from here is on disk. An event of a bus is in the chain of that bus, any
    other in that of the site. Without ``keys``, what seals the entries ends with the process: nothing that is
    kept may be written so."""

    def __init__(self, database: Database, clock: Clock = unix_now, keys: Keys | None = None) -> None:
        self.keys = keys or passing_keys()
        self.proof = LogProof(database, self.keys)
        self.repeated = RepeatedEvents(self.record, clock)
        self._database = database
        self._clock = clock
        self._subscribers: list[EventSubscriber] = []

    def subscribe(self, subscriber: EventSubscriber) -> Callable[[], None]:
        """Call ``subscriber`` with each event, a command again at its outcome; return what ends it."""
        self._subscribers.append(subscriber)
        return lambda: self._subscribers.remove(subscriber)

    async def intend_together(
        self, intents: Sequence[Mapping[str, Any]], also: Also | None = None
    ) -> list[int]:
        """Store commands before they are sent, in one transaction with ``also``; their numbers in order."""
        return await self._append_all([self._entry("command", **intent) for intent in intents], also)

    async def conclude_together(
        self,
        outcomes: Mapping[int, tuple[Outcome, str | Message]],
        texts: Mapping[int, Mapping[str, Message]] = NO_TEXTS,
    ) -> None:
        """Store the outcome and message of several commands, by event number, in one transaction. ``texts``:
        as in :meth:`conclude`."""
        entries = [
            self._entry("fate", about=event, outcome=outcome, message=message, **texts.get(event, {}))
            for event, (outcome, message) in outcomes.items()
        ]
        await self._write_all(entries)
        for event in outcomes:
            await self._publish_stored(event)

    async def conclude(
        self,
        event: int,
        outcome: Outcome,
        message: str | Message = "",
        frames: Sequence[Frame] = (),
        also: Also | None = None,
        texts: Mapping[str, Message] = NO_TEXTS,
    ) -> None:
        """Store the outcome of an intent; ``frames`` carried it. ``also``: in the same transaction.
        ``texts``: the fields ``old`` and ``new`` where the command has shown that they are others."""
        entry = self._entry("fate", about=event, outcome=outcome, message=message, frames=frames, **texts)
        await self._write_all([entry], also)
        await self._publish_stored(event)

    async def record(
        self,
        *,
        kind: EventKind,
        at: UnixTime | None = None,
        count: int = 1,
        also: Also | None = None,
        **fields: Unpack[EventFields],
    ) -> int:
        """Store a complete event; ``at``: when, if not just now, ``count``: how often, and ``also``
        what belongs to it, in the same transaction. Returns the event's number."""
        time = {} if at is None or not is_moment(at) else {"time": at}
        entry = self._entry(kind, **fields, count=count if count > 1 else None, **time)
        return (await self._append_all([entry], also))[0]

    async def close_open_intents(self, bus: str | None) -> int:
        """Record what of a bus, or of the site (None), was open when the last run ended as unverified. Return
        how many there were."""
        left = await self._database.read(lambda connection: store.open_intents(connection, bus))
        numbers = [intent["id"] for intent in left]
        for first in range(0, len(left), CHUNK):
            chunk = numbers[first : first + CHUNK]
            await self.conclude_together(dict.fromkeys(chunk, ("unverified", ENDED_BEFORE)))
        return len(left)

    async def page(self, wanted: Filter, limit: int) -> tuple[list[Event], int | None]:
        """Events newest first, and the number to continue from (None at the end)."""
        found = await self._database.read_costly(
            lambda connection: store.select(connection, wanted, limit + 1)
        )
        return found[:limit], found[limit - 1]["id"] if len(found) > limit else None

    async def every(self, wanted: Filter) -> AsyncIterator[list[Event]]:
        """All events that are wanted, newest first, in pieces."""
        while True:
            chunk, after = await self.page(wanted, CHUNK)
            yield chunk
            if after is None:
                return
            wanted = replace(wanted, before=after)

    async def kinds(self) -> list[str]:
        """Every kind there is an event of."""
        return await self._database.read_costly(store.kinds)

    async def _append_all(self, entries: Sequence[Event], also: Also | None = None) -> list[int]:
        numbers = await self._write_all(entries, also)
        for number, entry in zip(numbers, entries, strict=True):
            about = {"id": number, "concluded_at": None, "concluded_messages": None}
            self._publish(readable({"entered_at": None, **entry, **about}))
        return numbers

    async def _write_all(self, entries: Sequence[Event], also: Also | None = None) -> list[int]:
        def append(connection: StoreConnection) -> list[int]:
            numbers = appending.append(connection, entries, self.keys)
            if also is not None:
                also(connection)
            return numbers

        return await self._database.write(append)

    def _entry(self, kind: str, **members: Any) -> dict[str, Any]:
        return new_entry(**{"time": self._clock(), "kind": kind, **members})

    async def _publish_stored(self, number: int) -> None:
        if not self._subscribers:
            return
        try:
            event = await self._database.read(lambda connection: store.one(connection, number))
        except StoreUnavailableError:
            return
        if event is not None:
            self._publish(event)

    def _publish(self, event: Event) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:
                log.exception("subscriber of events failed", event_id=event["id"])


class LogProof:
    """Reads the log chunk by chunk in a thread: neither the event loop nor the store's checkpoint waits until
    all of a long log is read."""

    def __init__(self, database: Database, keys: Keys) -> None:
        self._database = database
        self._keys = keys
        self._one_at_a_time = asyncio.Lock()

    async def verify(self, anchors: Mapping[int, Head] | None = None) -> AuditVerification:
        """Whether the log is intact, and holds the heads that ``anchors`` names by entry; where None, those
        of the anchor beside the key."""
        async with self._one_at_a_time:
            if anchors is None:
                # Before the extent: the log may be ahead of its anchor, never behind.
                beside_key = await asyncio.to_thread(read_key_anchor, self._keys.path, self._keys.ring)
                anchors = beside_key.heads
            heads, last = await self.extent()
            ring = self._knowing(heads)
            walk = await self._database.read(lambda c: store.walk_from_cut(c, ring, anchors))
            await self._follow(walk, store.LOWEST_ID, last)
            return walk.end(heads)

    async def since(self, known: Mapping[str, Head]) -> AuditVerification:
        """Whether what was added after the ends of the chains at one instant, which are known to be good,
        continues them."""
        heads, last = await self.extent()
        ring, newest = self._knowing(heads), newest_of(known.values()).id
        cut = await self._database.read(lambda connection: newest_cut(connection, ring))
        if cut is not None and newest < cut.last:
            # What followed is archived meanwhile: the log goes on from there.
            known, newest = cut.ends, cut.last
        walk = Walk(ring, start=known)
        await self._follow(walk, newest + 1 if newest else store.LOWEST_ID, last)
        return walk.end(heads)

    async def extent(self) -> tuple[dict[str, Head], int]:
        """The newest entry of each chain as noted apart, and the number of the last one stored."""
        return await self._database.read(store.extent)

    async def links(self, heads: Mapping[str, Head]) -> dict[str, Head]:
        """The entries that heads name, as the next ones of their chains continue them; without those that are
        gone."""
        ring = self._knowing(heads)
        return await self._database.read(lambda connection: store.links_of(connection, heads, ring))

    def _knowing(self, heads: Mapping[str, Head]) -> KeyRing:
        return self._keys.knowing(newest_of(heads.values()).key)

    async def _follow(self, walk: Walk, number: int, until: int) -> None:
        def follow(connection: StoreConnection) -> int | None:
            return store.follow_chunk(connection, walk, number, until)

        while (following := await self._database.read(follow)) is not None:
            number = following
            await asyncio.sleep(0)
