"""A command in the events: its intent on disk before anything is sent, its result once it is known.

A change of several units is one event for the line and one for each unit, all in one transaction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import structlog

from app.core.database import Database, StoreConnection
from app.core.web.access import Person
from app.errors import Problem, StoreError
from app.line.commands.catalogue import kind_of_command
from app.line.commands.service import idempotency
from app.line.commands.service.command_request import CommandRequest
from app.line.commands.values import Wording, reworded
from app.line.live.bus_live import BusLive
from app.people.audit.log import EventLog
from app.people.audit.queries import link_parts
from bus.contract import Action, Outcome, Result
from bus.instants import Clock
from bus.messages import Message, term

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Intent:
    """The events of one command. ``parts``: unit → event, for a change of several. ``words``: of both, as
    they were stored before it was sent."""

    event: int
    parts: dict[int, int]
    words: Wording
    part_words: dict[int, Wording]


class CommandRecord:
    """Writes commands into the events, and their ids beside them."""

    def __init__(self, events: EventLog, database: Database, now: Clock) -> None:
        self._events = events
        self._database = database
        self._now = now

    async def earlier(self, person: Person, key: str) -> idempotency.Earlier | None:
        """Return this sender's earlier command with this key, also from before a restart."""
        return await self._database.read(lambda store: idempotency.find(store, person.sender, key))

    def result_of(self, earlier: idempotency.Earlier, key: str, bus: str, action: Action) -> Result:
        """Return the result of an earlier command with this key. Raises Problem 422 where it was not this
        action."""
        ring = self._events.keys.ring
        idempotency.refuse_other(key, same=idempotency.is_digest_of(earlier.command, ring, bus, action))
        return earlier.result

    async def intend(self, request: CommandRequest, live: BusLive) -> Intent:
        """On disk when this returns. Raises StoreError, and then nothing may be sent."""
        kind = kind_of_command(request.action)
        words, by_unit = kind.wording(request.action, live), dict(kind.part_wordings(request.action, live))
        group = _entry(request, request.action.only_unit, words)
        parts = [_entry(request, unit, part) for unit, part in by_unit.items()]
        begun = idempotency.begun(request, self._events.keys.ring, self._now())

        def beside(connection: StoreConnection) -> None:
            if begun is not None:
                begun(connection)
            if parts:
                link_parts(connection, len(parts))

        event, *others = await self._events.intend_together([group, *parts], beside)
        return Intent(event, dict(zip(by_unit, others, strict=True)), words, by_unit)

    async def conclude(self, intent: Intent, request: CommandRequest, result: Result, live: BusLive) -> None:
        """Record the result of an intent, and the values of a command that was given raw in the scale that
        was read with it, where it is another. The result stands even if the database fails now."""
        texts: dict[str, Message] = {}
        part_texts: dict[int, dict[str, Message]] = {}
        if request.scales is None:
            texts, part_texts = reworded(request.action, intent.words, intent.part_words, live)
        try:
            if intent.parts:
                await self._events.conclude_together(
                    _outcomes(intent, result),
                    {intent.parts[unit]: changed for unit, changed in part_texts.items()},
                )
            beside = idempotency.ended(request, result)
            message = result.message or ""
            await self._events.conclude(intent.event, result.outcome, message, result.frames, beside, texts)
        except StoreError as error:
            log.error("outcome not stored", command=request.id, outcome=result.outcome, error=str(error))

    async def reject(self, request: CommandRequest, live: BusLive, problem: Problem) -> None:
        """Record a rejected command with the reason."""
        entry = _entry(
            request, request.action.only_unit, kind_of_command(request.action).wording(request.action, live)
        )
        await self._events.record(kind="command", **entry, outcome=problem.code, message=problem.message)


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


def _outcomes(intent: Intent, result: Result) -> dict[int, tuple[Outcome, str | Message]]:
    by_unit = {part.unit: (part.outcome, part.message or "") for part in result.units}
    group = (result.outcome, result.message or "")
    return {event: by_unit.get(unit, group) for unit, event in intent.parts.items()}
