"""Commands by the idempotency key of their sender, in memory and on disk.

A command sent again with its key, also after a restart, returns the same result, and nothing is sent to the
unit. The key is stored in the transaction of the command's own event: it is known exactly when the intent is,
which is before anything is sent. Keys of different senders are independent.
"""

from __future__ import annotations

import asyncio
import json
from collections import OrderedDict
from dataclasses import dataclass

import msgspec

from app.core.database import StoreConnection
from app.core.web.access import Person
from app.errors import Problem
from app.line.commands.service.command_request import CommandRequest
from app.people.audit.chain import KeyRing
from app.people.audit.log import Also
from bus.contract import Action, Result
from bus.instants import UnixTime
from bus.messages import Message

MAX_AGE_S = 7 * 86_400.0
"""How long a key is remembered."""
MAX_OF_A_SENDER = 2000
"""How many keys of one sender are remembered; the oldest are forgotten first."""
UNREADABLE = Message("result_unreadable")
_FROM_BEFORE = ""
"""The sender of keys that an earlier version has stored without one."""
_FORGET_OLD = "DELETE FROM idempotency WHERE requested_at < ?"
_FORGET_MANY = """
DELETE FROM idempotency WHERE sender = :sender AND result IS NOT NULL AND requested_at < (
    SELECT requested_at FROM idempotency WHERE sender = :sender
    ORDER BY requested_at DESC LIMIT 1 OFFSET :others
)
"""
_INSERT = "INSERT INTO idempotency (sender, key, requested_at, command) VALUES (?, ?, ?, ?)"


@dataclass(frozen=True, slots=True)
class Earlier:
    """The command of a key. ``command``: digest of the request."""

    command: str
    result: Result


def digest(ring: KeyRing, bus: str, action: Action) -> str:
    """Identifies a command without storing it. Keyed with the server's secret: a
    password of few digits (#21) could be found from a plain hash by trying all."""
    return ring.seal("command", *_parts(bus, action))


def is_digest_of(command: str, ring: KeyRing, bus: str, action: Action) -> bool:
    """Whether ``command`` was made of this one, with any key that the server ever had."""
    return ring.confirms_by_any(command, "command", *_parts(bus, action))


def _parts(bus: str, action: Action) -> tuple[str, str]:
    fields = msgspec.to_builtins(action, str_keys=True)
    return json.dumps(bus), json.dumps(fields, sort_keys=True)


def refuse_other(key: str | None, *, same: bool) -> None:
    """Raises Problem 422 for a key that its sender has used for another command."""
    if not same:
        raise Problem(422, "invalid", Message.of("id_used", id=str(key)), id=key)


def begun(request: CommandRequest, ring: KeyRing, now: UnixTime) -> Also | None:
    """What stores, beside its event, that the result of a command with a key is open; None without a key. It
    raises ConstraintError for a key that its sender has used."""
    if request.key is None:
        return None
    sender, row = request.person.sender, (request.key, float(now), digest(ring, request.bus, request.action))

    def write(connection: StoreConnection) -> None:
        connection.execute(_FORGET_OLD, (now - MAX_AGE_S,))
        connection.execute(_FORGET_MANY, {"sender": sender, "others": MAX_OF_A_SENDER - 2})
        connection.execute(_INSERT, (sender, *row))

    return write


def ended(request: CommandRequest, result: Result) -> Also | None:
    """What stores the result of a command with a key, without the frames, which are in the events; None
    without a key."""
    if request.key is None:
        return None
    stored = msgspec.json.encode(msgspec.structs.replace(result, frames=[]))
    values = (stored, request.person.sender, request.key)
    query = "UPDATE idempotency SET result = ? WHERE sender = ? AND key = ?"
    return lambda connection: connection.execute(query, values)


def find(connection: StoreConnection, sender: str, key: str) -> Earlier | None:
    """The command of a sender's key; *unverified* where the server ended before its result."""
    row = connection.execute(
        "SELECT requested_at, command, result FROM idempotency WHERE sender IN (?, ?) AND key = ?",
        (sender, _FROM_BEFORE, key),
    ).fetchone()
    if row is None:
        return None
    requested_at, command, result = row
    if result is None:
        return Earlier(command, Result(key, requested_at, "unverified", Message("server_stopped")))
    try:
        return Earlier(command, msgspec.json.decode(result, type=Result))
    except msgspec.MsgspecError:
        return Earlier(command, Result(key, requested_at, "unverified", UNREADABLE))


REMEMBERED = 1000
"""Results kept for senders that repeat a key."""


@dataclass(frozen=True, slots=True)
class KeptCommand:
    """A command that is under way or done."""

    bus: str
    action: Action
    result: asyncio.Task[Result]


@dataclass(frozen=True, slots=True)
class CommandKey:
    """The id that a sender has given a command, looked up. At most one is there: ``kept``, the command with
    this id that this server has taken, or ``stored``, one from before its start."""

    id: str
    kept: KeptCommand | None = None
    stored: Earlier | None = None

    @property
    def is_used(self) -> bool:
        """Whether the sender has sent a command with this id before."""
        return self.kept is not None or self.stored is not None


class IdempotencyCache:
    """One for the site: a key belongs to its sender, whichever bus the command is for."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str, str], KeptCommand] = OrderedDict()

    def find(self, person: Person, key: str | None) -> KeptCommand | None:
        """Return the command that this sender gave this key; None without one."""
        return self._kept.get((person.sender, key)) if key else None

    def keep(self, person: Person, key: str, command: KeptCommand) -> None:
        place = (person.sender, key)
        self._kept[place] = command
        while len(self._kept) > REMEMBERED and next(iter(self._kept.values())).result.done():
            self._kept.popitem(last=False)

        def forget_failed(result: asyncio.Task[Result]) -> None:
            # It has no result to give again: what was sent, if anything was, is on disk.
            if result.cancelled() or result.exception() is not None:
                self._kept.pop(place, None)

        command.result.add_done_callback(forget_failed)
