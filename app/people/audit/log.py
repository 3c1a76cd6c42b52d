"""The event log: each entry continues the chain, in the transaction of its subject; and queries of it,
filtered and searched, each command with its outcome.

Events that strangers can cause are bounded: repetitions are counted and recorded once a minute.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, Required, TypedDict, Unpack

import structlog

from app.core.database import Database, StoreConnection
from app.core.database.connection import json_member
from app.core.server.refusal_log import WINDOW_S, Repeats, Repetition
from app.errors import StoreError
from app.people.audit.entry import (
    END_ALTERED,
    FIELDS,
    JOINED,
    SITE,
    EventKind,
    Head,
    chains_named,
    is_moment,
    new_entry,
    newest_of,
    previous_after,
    readable,
    remark_on,
    sealed_entry,
    sealed_head,
)
from app.people.audit.entry import Event as Event
from app.people.audit.keys import Keys, passing_keys
from app.people.audit.proof import LogProof
from bus.contract import Frame, Outcome
from bus.instants import Clock, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message, joined

_FOLDED = """
SELECT e.id, e.time, e.kind, e.who, e.origin, e.bus, e.unit, e.what,
       COALESCE(f.old, e.old) AS old, COALESCE(f.new, e.new) AS new, e.old_raw, e.new_raw,
       COALESCE(f.outcome, e.outcome) AS outcome, COALESCE(f.message, e.message) AS message,
       COALESCE(f.frames, e.frames) AS frames, e.count, f.time AS concluded_at,
       e.messages, f.messages AS concluded_messages
FROM events e LEFT JOIN events f ON f.about = e.id
WHERE e.about IS NULL
"""
UnitPlace = tuple[str, int]
"""The name of a bus, and the address of a unit."""
_SEARCHED = ("what", "who", "old", "new", "message")
_IN_GROUP = """
SELECT 1 FROM event_parts JOIN events change ON change.id = event_parts.change
LEFT JOIN events change_result ON change_result.about = change.id
WHERE event_parts.event = e.id
"""


@dataclass(frozen=True)
class Filter:
    """The events of a query; None or empty does not filter. Times are in seconds since the epoch.

    ``code`` and ``number``: those of the message in ``what``, which older events do not have; ``named``:
    units that ``search`` names, whose events are found too; ``newest``: only so many of the newest entries
    are searched, which bounds the cost; ``folded``: without the parts of a change that is in the result;
    ``parts_of``: only the parts of these changes."""

    before: int | None = None
    kind: str | None = None
    bus: str | None = None
    unit: int | None = None
    who: str | None = None
    since: UnixTime | None = None
    until: UnixTime | None = None
    search: str = ""
    named: tuple[UnitPlace, ...] = ()
    code: str | None = None
    number: int | None = None
    old_raw: int | None = None
    new_raw: int | None = None
    folded: bool = False
    parts_of: tuple[int, ...] | None = None
    after: int | None = None
    newest: int | None = None

    def conditions(self, event: str = "e", conclusion: str = "f") -> tuple[str, list[Any]]:
        """Return SQL to append to a query, and its values. ``event``, ``conclusion``: the aliases of the
        events and of their conclusions in the query."""
        messages = f"{event}.messages"
        number = None if self.number is None else str(self.number)
        given = {
            f"{event}.id < ?": self.before,
            f"{event}.id > ?": self.after,
            f"{event}.id > (SELECT max(id) FROM events) - ?": self.newest,
            f"{event}.kind = ?": self.kind,
            f"{event}.bus = ?": self.bus,
            f"{event}.unit = ?": self.unit,
            f"{event}.who = ?": self.who,
            f"{event}.time >= ?": self.since,
            f"{event}.time < ?": self.until,
            f"{event}.old_raw = ?": self.old_raw,
            f"{event}.new_raw = ?": self.new_raw,
            f"{json_member(messages, 'what.code')} = ?": self.code,
            f"{json_member(messages, 'what.params.number')} = ?": number,
        }
        parts = [f"AND {condition}" for condition, value in given.items() if value is not None]
        values: list[Any] = [value for value in given.values() if value is not None]
        if self.search:
            columns = (*(f"{event}.{column}" for column in _SEARCHED), f"{conclusion}.message")
            either = [f"{column} LIKE ? ESCAPE '!'" for column in columns]
            if self.named:
                either.append(
                    f"({event}.bus, {event}.unit) IN (VALUES {', '.join(['(?, ?)'] * len(self.named))})"
                )
            parts.append(f"AND ({' OR '.join(either)})")
            values += [_pattern(self.search)] * len(columns)
            values += [part for place in self.named for part in place]
        for clause, more in self._grouping():
            parts.append(clause)
            values += more
        return " ".join(parts), values

    def _grouping(self) -> Iterator[tuple[str, list[Any]]]:
        if self.folded:
            group, values = replace(self, before=None, folded=False, parts_of=None).conditions(
                "change", "change_result"
            )
            yield f"AND NOT EXISTS ({_IN_GROUP} {group})", values
        if self.parts_of is not None:
            marks = ", ".join("?" * len(self.parts_of))
            yield f"AND e.id IN (SELECT event FROM event_parts WHERE change IN ({marks}))", [*self.parts_of]


def _pattern(text: str) -> str:
    for special in "!%_":
        text = text.replace(special, f"!{special}")
    return f"%{text}%"


def select(connection: StoreConnection, wanted: Filter, limit: int) -> list[dict[str, Any]]:
    """Return events newest first, each command with its outcome."""
    conditions, values = wanted.conditions()
    query = f"{_FOLDED} {conditions} ORDER BY e.id DESC LIMIT ?"
    return [readable(dict(row)) for row in connection.execute(query, [*values, limit])]


def one(connection: StoreConnection, number: int) -> dict[str, Any] | None:
    """Return one event with its outcome."""
    row = connection.execute(f"{_FOLDED} AND e.id = ?", (number,)).fetchone()
    return readable(dict(row)) if row else None


def kinds(connection: StoreConnection) -> list[str]:
    """Return the kinds of all events, each found by one look into the index."""
    query = (
        "WITH RECURSIVE k(kind) AS (SELECT min(kind) FROM events WHERE about IS NULL UNION ALL "
        "SELECT (SELECT min(kind) FROM events WHERE about IS NULL AND kind > k.kind) FROM k "
        "WHERE kind IS NOT NULL) SELECT kind FROM k WHERE kind IS NOT NULL"
    )
    return [row["kind"] for row in connection.execute(query)]


def open_intents(connection: StoreConnection) -> list[int]:
    """Return the numbers of commands without an outcome."""
    query = (
        "SELECT id FROM events e WHERE e.kind = 'command' AND e.about IS NULL AND e.outcome IS NULL "
        "AND NOT EXISTS (SELECT 1 FROM events f WHERE f.about = e.id)"
    )
    return [row["id"] for row in connection.execute(query)]


def link_parts(connection: StoreConnection, count: int) -> None:
    """Note that the last ``count`` events are parts of the one before them, in the transaction that wrote
    them."""
    [last] = connection.execute("SELECT max(id) FROM events").fetchone()
    rows = [(number, last - count) for number in range(last - count + 1, last + 1)]
    connection.executemany("INSERT INTO event_parts (event, change) VALUES (?, ?)", rows)


log = structlog.get_logger()


class Logged(NamedTuple):
    """An event that was just stored, or a command whose outcome was: ``id`` is the command's."""

    id: int
    kind: str
    bus: str | None
    outcome: str | None


EventSubscriber = Callable[[Logged], None]
Also = Callable[[StoreConnection], object]
"""A function that writes something else in the transaction of an event."""

CHUNK = 1000
ENDED_BEFORE = Message("server_stopped")


class EventFields(TypedDict, total=False):
    """The fields that an event may have."""

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
    """An append-only log; entries are on disk when its methods return. Without ``keys`` the keys end with the
    process, so that nothing can verify the entries later."""

    def __init__(self, database: Database, clock: Clock = unix_now, keys: Keys | None = None) -> None:
        self.keys = keys or passing_keys()
        self.proof = LogProof(database, self.keys)
        self.repeated = RepeatedEvents(self.record, clock)
        self._database = database
        self._clock = clock
        self._subscribers: list[EventSubscriber] = []

    def subscribe(self, subscriber: EventSubscriber) -> Callable[[], None]:
        """Call ``subscriber`` with each event, and again with the outcome of a command; return a function
        that ends the subscription."""
        self._subscribers.append(subscriber)
        return lambda: self._subscribers.remove(subscriber)

    async def intend_together(
        self, intents: Sequence[Mapping[str, Any]], also: Also | None = None
    ) -> list[int]:
        """Store commands before they are sent, in one transaction with ``also``; return their numbers in
        order."""
        return await self._append_all([self._entry("command", **intent) for intent in intents], also)

    async def conclude_together(
        self,
        outcomes: Mapping[int, tuple[Outcome, str | Message]],
        texts: Mapping[int, Mapping[str, Message]] = NO_TEXTS,
    ) -> None:
        """Store outcome and message of several commands, by event number, in one transaction. ``texts``: as
        in :meth:`conclude`."""
        entries = [
            self._entry("fate", about=event, outcome=outcome, message=message, **texts.get(event, {}))
            for event, (outcome, message) in outcomes.items()
        ]
        await self._conclude(entries)

    async def conclude(
        self,
        event: int,
        outcome: Outcome,
        message: str | Message = "",
        frames: Sequence[Frame] = (),
        also: Also | None = None,
        texts: Mapping[str, Message] = NO_TEXTS,
    ) -> None:
        """Store the outcome of an intent, which ``frames`` carried, in one transaction with ``also``.
        ``texts``: ``old`` and ``new`` if the command has shown that they differ from those of the intent."""
        entry = self._entry("fate", about=event, outcome=outcome, message=message, frames=frames, **texts)
        await self._conclude([entry], also)

    async def record(
        self,
        *,
        kind: EventKind,
        at: UnixTime | None = None,
        count: int = 1,
        also: Also | None = None,
        **fields: Unpack[EventFields],
    ) -> int:
        """Store a complete event, in one transaction with ``also``; return its number. ``at``: when it
        happened, if not just now; ``count``: how often."""
        time = {} if at is None or not is_moment(at) else {"time": at}
        entry = self._entry(kind, **fields, count=count if count > 1 else None, **time)
        return (await self._append_all([entry], also))[0]

    async def close_open_intents(self) -> int:
        """Conclude as unverified, at the start, the commands that were open when the last run ended; return
        their number."""
        left = await self._database.read(open_intents)
        for first in range(0, len(left), CHUNK):
            chunk = left[first : first + CHUNK]
            await self.conclude_together(dict.fromkeys(chunk, ("unverified", ENDED_BEFORE)))
        return len(left)

    async def page(self, wanted: Filter, limit: int) -> tuple[list[Event], int | None]:
        """Return events newest first, and the number to continue from (None at the end)."""
        found = await self._database.read_costly(lambda connection: select(connection, wanted, limit + 1))
        return found[:limit], found[limit - 1]["id"] if len(found) > limit else None

    async def every(self, wanted: Filter) -> AsyncIterator[list[Event]]:
        """Yield all events of a filter, newest first, in chunks."""
        while True:
            chunk, after = await self.page(wanted, CHUNK)
            yield chunk
            if after is None:
                return
            wanted = replace(wanted, before=after)

    async def kinds(self) -> list[str]:
        """Return the kinds of all events."""
        return await self._database.read_costly(kinds)

    async def _append_all(self, entries: Sequence[Event], also: Also | None = None) -> list[int]:
        numbers = await self._database.write(lambda connection: self._append(connection, entries, also))
        for number, entry in zip(numbers, entries, strict=True):
            self._publish(Logged(number, entry["kind"], entry["bus"], entry["outcome"]))
        return numbers

    async def _conclude(self, outcomes: Sequence[Event], also: Also | None = None) -> None:
        """Store outcomes, and publish the commands that they conclude."""

        def write(connection: StoreConnection) -> list[Logged]:
            self._append(connection, outcomes, also)
            query = "SELECT kind, bus FROM events WHERE id = ?"
            return [
                Logged(outcome["about"], row["kind"], row["bus"], outcome["outcome"])
                for outcome in outcomes
                for row in connection.execute(query, (outcome["about"],))
            ]

        for event in await self._database.write(write):
            self._publish(event)

    def _append(self, connection: StoreConnection, entries: Sequence[Event], also: Also | None) -> list[int]:
        numbers = append(connection, entries, self.keys)
        if also is not None:
            also(connection)
        return numbers

    def _entry(self, kind: str, **members: Any) -> dict[str, Any]:
        return new_entry(**{"time": self._clock(), "kind": kind, **members})

    def _publish(self, event: Logged) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:
                log.exception("subscriber of events failed", event_id=event.id)


_COLUMNS = (*FIELDS, "count", "messages", "key", "previous", "hash", "seal")
"""A further column must allow NULL and be listed here; the hash covers it wherever it is not NULL."""
_INSERT = f"INSERT INTO events ({', '.join(_COLUMNS)}) VALUES ({', '.join('?' * len(_COLUMNS))})"
_LAST = "SELECT id, hash, key, chain FROM events ORDER BY id DESC LIMIT 1"
_HEADS = "SELECT id, hash, key, seal, chain FROM events_head"
_NOTE_HEAD = """
INSERT INTO events_head (chain, id, hash, key, seal) VALUES (?, ?, ?, ?, ?)
ON CONFLICT (chain) DO UPDATE
SET id = excluded.id, hash = excluded.hash, key = excluded.key, seal = excluded.seal
"""


def append(connection: StoreConnection, entries: Sequence[Mapping[str, Any]], keys: Keys) -> list[int]:
    """Append entries, which have no ids yet; return their ids. If the end of the log is not sealed with a
    known key or there are several chains, entries about that come first."""
    if not entries:
        return []
    ends, is_altered = _ends(connection)
    last = newest_of(ends.values())
    ring = keys.knowing(last.key)
    remarks = [remark for end in ends.values() if (remark := remark_on(end, ring)) is not None]
    found: list[tuple[Message, Message | str]] = [(remark, "") for remark in remarks[:1]]
    if is_altered:
        found = [(END_ALTERED, "")]
    if len(ends) > 1:
        found.append((JOINED, joined(chains_named(ends)) or ""))
    time = entries[0]["time"]
    first = [new_entry(kind="audit", time=time, what=what, message=why) for what, why in found]
    number, previous, row = last.id, previous_after(ends), {}
    for number, entry in enumerate([*first, *entries], start=last.id + 1):
        # This is exactly the row's content: the hash of anything else would not match it.
        row = {name: entry.get(name) for name in _COLUMNS} | {"id": number}
        row = sealed_entry(previous, row, ring)
        connection.execute(_INSERT, [row[name] for name in _COLUMNS])
        previous = row["hash"]
    head = sealed_head(row, ring)
    connection.execute(_NOTE_HEAD, (SITE, head.id, head.hash, head.key, head.seal))
    return [*range(number - len(entries) + 1, number + 1)]


def _ends(connection: StoreConnection) -> tuple[dict[str, Head], bool]:
    """Return the end of each chain that the next entry continues, and whether there are entries behind the
    noted end, which this program cannot have written."""
    last = connection.execute(_LAST).fetchone()
    is_one = last is not None and last["chain"] is None
    rows = connection.execute(f"{_HEADS} WHERE chain = ''" if is_one else _HEADS)
    ends = {row["chain"]: Head(*row) for row in rows}
    if last is None or last["id"] <= newest_of(ends.values()).id:
        return ends, False
    chain = last["chain"] or SITE
    return {**ends, chain: Head(last["id"], last["hash"], last["key"], chain=chain)}, True


MAX_KEYS = 20
"""The number of places and messages of a group that have separate events in a minute."""
MANY = Message("many_addresses")
"""The origin of events of all further places together."""
_Text = str | Message
_RepeatedEvent = tuple[EventKind, _Text, _Text, _Text, _Text, UnixTime]
"""The kind, what, who, origin, message and time of an event."""


class RepeatedEvents:
    """A recorder of the first event of a kind, person, place and message at once, then of one a minute with
    the number of repetitions. Places are counted separately for each person, so that a flood hides nobody who
    is under attack; the number of ``who`` is bounded. ``record``: `EventLog.record`; ``clock``: Unix time in
    seconds; ``now`` measures the minutes."""

    def __init__(
        self, record: Callable[..., Awaitable[object]], clock: Clock, now: MonotonicClock = monotonic_now
    ) -> None:
        self._record = record
        self._clock = clock
        self._now = now
        self._groups: dict[tuple[EventKind, _Text], Repeats[_RepeatedEvent]] = defaultdict(
            partial(Repeats, MAX_KEYS)
        )

    async def count(
        self, kind: EventKind, what: _Text, *, who: _Text = "", origin: _Text = "", message: _Text = ""
    ) -> None:
        """Count one more event that a stranger can cause as often as they like."""
        event = (kind, what, who, origin, message, self._clock())
        first = self._groups[kind, who].note((what, origin, message), event, self._now())
        if first is not None:
            await self._record_counted(first)

    async def follow(self) -> None:
        """Record the counts of minutes that are over, until canceled."""
        while True:
            await asyncio.sleep(WINDOW_S / 4)
            await self.record_due()

    async def record_due(self, *, everything: bool = False) -> None:
        """Record the counts of minutes that are over, or ``everything`` as the server ends. Raise StoreError
        once each was tried."""
        failed: StoreError | None = None
        now = self._now()
        for repeats in list(self._groups.values()):
            for counted in repeats.take_counted(now, everything=everything):
                try:
                    await self._record_counted(counted)
                except StoreError as error:
                    failed = error
        if failed is not None:
            raise failed

    async def _record_counted(self, counted: Repetition[_RepeatedEvent]) -> None:
        kind, what, who, origin, message, at = counted.item
        if counted.is_of_others:
            origin, message = MANY, ""
        fields = {"what": what, "who": who, "origin": origin, "message": message}
        await self._record(kind=kind, at=at, count=counted.count, **fields)
