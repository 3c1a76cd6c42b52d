"""The record of commands: in the events, and under the keys of their senders.

The intent of a command is on disk before anything is sent, its result once it is known. A change of several
units is one event for the line and one for each unit, all in one transaction.

A command sent again with its idempotency key, even after a restart, returns the same result, and nothing is
sent to the unit. The key is stored in the transaction of the command's own event: it is known exactly when
the intent is, which is before anything is sent. Keys of different senders are independent.
"""

from __future__ import annotations

import asyncio
import json
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import structlog
from msgspec.structs import replace

from app.core.database import Database, StoreConnection
from app.core.web.access import Person
from app.core.web.arrival import Deadline
from app.errors import Problem, StoreError
from app.line.commands.catalogue import kind_of_command
from app.line.commands.values import Scales, Wording, reworded, with_names
from app.line.live.bus_live import BusLive
from app.people.audit.acts import Act
from app.people.audit.entry import KeyRing
from app.people.audit.log import EventLog, link_parts
from bus.contract import Action, Outcome, Result, UnitOutcome
from bus.instants import Clock, UnixTime
from bus.messages import Message, joined, term

log = structlog.get_logger()

CommandOrigin = Literal["api", "batch edit", "change tray", "page", "restore", "unit swap"]
"""The way in which a command was sent; for a recipe it is a message with its name."""


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """A command as a user or program requested it. ``deadline``: the last moment at which a frame that
    writes may leave."""

    id: str
    person: Person
    bus: str
    action: Action
    deadline: Deadline
    origin: CommandOrigin | Message
    key: str | None = None
    """The sender's key, by which it gets the result again."""
    undoes: str = ""
    """The key of the command that this one undoes."""
    scales: Scales | None = None
    """The scales in which its values were shown and typed; None if they were given raw."""

    @property
    def can_be_undone(self) -> bool:
        """Whether a person has sent it from a page, as a command, in a batch edit or a change tray, or by a
        recipe."""
        from_page = self.origin in ("page", "batch edit", "change tray") or isinstance(self.origin, Message)
        return self.person.via != "token" and from_page


def without_secret(action: Action, result: Result) -> Result:
    """Return ``result`` in the form to store and show: for a secret without the value read back, the frames,
    and words that may name it."""
    if not kind_of_command(action).is_secret(action):
        return result
    units = [replace(unit, read_back=None, message=_masked(unit)) for unit in result.units]
    return replace(result, read_back=None, message=_masked(result), units=units, values=[], frames=[])


def _masked(result: Result | UnitOutcome) -> Message | None:
    """Replace a message that states the value read back instead of the requested one."""
    differs = result.read_back is not None and result.outcome != "verified"
    return Message("secret_differs") if differs else result.message


@dataclass(frozen=True, slots=True)
class Intent:
    """The events of one command. ``parts``: unit → event, for a change of several. ``words``: those of both,
    as stored before it was sent."""

    event: int
    parts: dict[int, int]
    words: Wording
    part_words: dict[int, Wording]


@dataclass(frozen=True, slots=True)
class KeptCommand:
    """A command that is under way or done."""

    bus: str
    action: Action
    result: asyncio.Task[Result]


@dataclass(frozen=True, slots=True)
class StoredCommand:
    """A command of a key from before the start of the server. ``digest``: that of its request."""

    digest: str
    result: Result


@dataclass(frozen=True, slots=True)
class CommandKey:
    """The result of looking up the id that a sender has given a command. At most one is set: ``kept``, the
    command that this server has taken, or ``stored``, one from before its start."""

    id: str
    kept: KeptCommand | None = None
    stored: StoredCommand | None = None

    @property
    def is_used(self) -> bool:
        """Whether the sender has sent a command with this id before."""
        return self.kept is not None or self.stored is not None


MAX_KEPT = 1000
"""The most results kept in memory for senders that repeat a key."""
MAX_AGE_S = 7 * 86_400.0
"""The seconds for which the key of a command is stored."""
MAX_OF_A_SENDER = 2000
"""The most stored keys of one sender; the oldest are deleted first."""
UNREADABLE = Message("result_unreadable")
_FROM_BEFORE = ""
"""The sender of keys that an earlier version has stored without a sender."""


class CommandRecord:
    """The record of the commands of a site, in the events, and by their keys in memory and on disk. There is
    one for all buses, because a key belongs to its sender."""

    def __init__(self, events: EventLog, database: Database, now: Clock) -> None:
        self._events = events
        self._database = database
        self._now = now
        self._kept: OrderedDict[tuple[str, str], KeptCommand] = OrderedDict()

    def kept(self, person: Person, key: str | None) -> KeptCommand | None:
        """Return the command that this sender gave this key since the start; None without a key."""
        return self._kept.get((person.sender, key)) if key else None

    def keep(self, person: Person, key: str, command: KeptCommand) -> None:
        """Keep a command that was taken, until its result is old."""
        place = (person.sender, key)
        self._kept[place] = command
        while len(self._kept) > MAX_KEPT and next(iter(self._kept.values())).result.done():
            self._kept.popitem(last=False)

        def forget_failed(result: asyncio.Task[Result]) -> None:
            # It has no result to return again: what was sent, if anything, is on disk.
            if result.cancelled() or result.exception() is not None:
                self._kept.pop(place, None)

        command.result.add_done_callback(forget_failed)

    async def look_up(self, person: Person, key: str) -> CommandKey:
        """Look up the command that this person has sent with a key; an empty one names none."""
        kept, stored = self.kept(person, key), None
        if key and kept is None:
            stored = await self._database.read(lambda store: find_key(store, person.sender, key))
            # Another request with this key may have come meanwhile.
            kept = self.kept(person, key)
        return CommandKey(key, kept, None if kept is not None else stored)

    def result_of(self, stored: StoredCommand, key: str, bus: str, action: Action) -> Result:
        """Return the result of a stored command. Raise Problem 422 if it was not this action."""
        ring = self._events.keys.ring
        same = ring.confirms_by_any(stored.digest, "command", *_digested(bus, action))
        refuse_other(key, same=same)
        return stored.result

    async def intend(self, request: CommandRequest, live: BusLive) -> Intent:
        """Store a command before it is sent. Raise StoreError, after which nothing may be sent."""
        kind = kind_of_command(request.action)
        words, by_unit = kind.wording(request.action, live), dict(kind.part_wordings(request.action, live))
        group = _entry(request, request.action.only_unit, words)
        parts = [_entry(request, unit, part) for unit, part in by_unit.items()]
        ring, now = self._events.keys.ring, self._now()

        def beside(store: StoreConnection) -> None:
            begin_key(store, request, ring, now)
            if parts:
                link_parts(store, len(parts))

        event, *others = await self._events.intend_together([group, *parts], beside)
        return Intent(event, dict(zip(by_unit, others, strict=True)), words, by_unit)

    async def conclude(self, intent: Intent, request: CommandRequest, result: Result, live: BusLive) -> None:
        """Store the result of an intent, and the values of a command that was given raw in the scale that was
        read with it, if that differs. The result stands even if the database fails now."""
        texts: dict[str, Message] = {}
        part_texts: dict[int, dict[str, Message]] = {}
        said = with_names(result.message, live) if result.message else None
        if request.scales is None:
            texts, part_texts = reworded(request.action, intent.words, intent.part_words, live)
        try:
            if intent.parts:
                await self._events.conclude_together(
                    _outcomes(intent, result, live),
                    {intent.parts[unit]: changed for unit, changed in part_texts.items()},
                )
            await self._events.conclude(
                intent.event,
                result.outcome,
                joined((_found_addresses(result), said)) or "",
                result.frames,
                lambda store: end_key(store, request, result),
                texts,
            )
        except StoreError as error:
            log.error("outcome not stored", command=request.id, outcome=result.outcome, error=str(error))

    async def note(self, act: Act, person: Person, bus: str) -> None:
        """Record an act of a person on the commands of a bus."""
        await self._events.record(**act.by(person), bus=bus)

    async def reject(self, request: CommandRequest, live: BusLive, problem: Problem) -> None:
        """Record a rejected command with the reason."""
        words = kind_of_command(request.action).wording(request.action, live)
        entry = _entry(request, request.action.only_unit, words)
        message = with_names(problem.message, live)
        await self._events.record(kind="command", **entry, outcome=problem.code, message=message)


def _entry(request: CommandRequest, unit: int | None, words: Wording) -> dict[str, Any]:
    return {
        "who": request.person.name,
        "origin": _origin(request),
        "bus": request.bus,
        "unit": unit,
        "what": words.what,
        "old": words.old or None,
        "new": words.new or None,
        "old_raw": words.old_raw,
        "new_raw": words.new_raw,
    }


def _origin(request: CommandRequest) -> str | Message:
    if request.person.via != "token":
        return request.origin
    origin = request.origin if isinstance(request.origin, Message) else term(request.origin)
    return Message.of("origin_token", origin=origin)


def _found_addresses(result: Result) -> Message | None:
    """Return the addresses that responded to a scan; None if none did."""
    found = [each.unit for each in result.found]
    return Message.of("scan_found", n=len(found), addresses=found) if found else None


def _named(result: Result | UnitOutcome, live: BusLive) -> str | Message:
    unit = result.unit if isinstance(result, UnitOutcome) else None
    return with_names(result.message, live, unit) if result.message else ""


def _outcomes(intent: Intent, result: Result, live: BusLive) -> dict[int, tuple[Outcome, str | Message]]:
    by_unit = {part.unit: (part.outcome, _named(part, live)) for part in result.units}
    group = (result.outcome, _named(result, live))
    return {event: by_unit.get(unit, group) for unit, event in intent.parts.items()}


def refuse_other(key: str | None, *, same: bool) -> None:
    """Raise Problem 422 for a key that its sender has used for another command."""
    if not same:
        raise Problem(422, "invalid", Message.of("id_used", id=str(key)), id=key)


def digest(ring: KeyRing, bus: str, action: Action) -> str:
    """Return a keyed digest of a command. It is keyed with the server's secret, because a password of few
    digits (#21) could be found from a plain hash by trying all."""
    return ring.seal("command", *_digested(bus, action))


def _digested(bus: str, action: Action) -> tuple[str, str]:
    fields = msgspec.to_builtins(action, str_keys=True)
    return json.dumps(bus), json.dumps(fields, sort_keys=True)


_FORGET_OLD = "DELETE FROM idempotency WHERE requested_at < ?"
_FORGET_MANY = """
DELETE FROM idempotency WHERE sender = :sender AND result IS NOT NULL AND requested_at < (
    SELECT requested_at FROM idempotency WHERE sender = :sender
    ORDER BY requested_at DESC LIMIT 1 OFFSET :others
)
"""
_INSERT = "INSERT INTO idempotency (sender, key, requested_at, command) VALUES (?, ?, ?, ?)"


def begin_key(store: StoreConnection, request: CommandRequest, ring: KeyRing, now: UnixTime) -> None:
    """Store that the result of a command with a key is open. Raise ConstraintError for a key that its sender
    has used."""
    if request.key is None:
        return
    sender = request.person.sender
    store.execute(_FORGET_OLD, (now - MAX_AGE_S,))
    store.execute(_FORGET_MANY, {"sender": sender, "others": MAX_OF_A_SENDER - 2})
    store.execute(_INSERT, (sender, request.key, float(now), digest(ring, request.bus, request.action)))


def end_key(store: StoreConnection, request: CommandRequest, result: Result) -> None:
    """Store the result of a command with a key, without the frames, which are in the events."""
    if request.key is None:
        return
    stored = msgspec.json.encode(replace(result, frames=[]))
    query = "UPDATE idempotency SET result = ? WHERE sender = ? AND key = ?"
    store.execute(query, (stored, request.person.sender, request.key))


def find_key(store: StoreConnection, sender: str, key: str) -> StoredCommand | None:
    """Find the command of a sender's key; it is *unverified* if the server ended before its result."""
    row = store.execute(
        "SELECT requested_at, command, result FROM idempotency WHERE sender IN (?, ?) AND key = ?",
        (sender, _FROM_BEFORE, key),
    ).fetchone()
    if row is None:
        return None
    requested_at, command, result = row
    if result is None:
        return StoredCommand(command, Result(key, requested_at, "unverified", Message("server_stopped")))
    try:
        return StoredCommand(command, msgspec.json.decode(result, type=Result))
    except msgspec.MsgspecError:
        return StoredCommand(command, Result(key, requested_at, "unverified", UNREADABLE))
