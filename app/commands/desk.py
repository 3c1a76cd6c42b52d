"""The one way from a wish to the wire: checked, written down, sent once, followed to its fate."""

from __future__ import annotations

import asyncio
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from app.audit.log import EventLog
from app.commands.control import ControlledError
from app.commands.idempotency import command_of
from app.commands.moves import Moves
from app.commands.objection import Circumstances, ObjectionError
from app.commands.record import Record
from app.commands.rules import check, is_write, setpoints_of, units_named, units_written
from app.commands.safeguards import Safeguards
from app.commands.setpoints import commanded_setpoint
from app.commands.wish import Wish, time_for
from app.database import Database
from app.errors import Problem
from app.feed.channel import Channel, ProgressListener
from app.live.lookup import bus_or_404, unit_or_404
from app.live.state import BusLive, LiveState
from app.web.access import Person
from bus.contract import Action, ChangeBaud, Command, Result, ScanBus, SetSpeed, WriteParameter

REMEMBERED = 1000
"""Fates kept for whoever asks with the same id again."""
STATUS_OF_OBJECTION = {"invalid": 422, "dangerous": 409, "confirm_needed": 409, "blocked": 423}
ACTED = ("verified", "acknowledged", "unverified")
"""Outcomes after which a unit has acted, or may have."""


class BeforeWrite(Protocol):
    """Told who is about to write to which units of a bus, and whether it is parameters."""

    async def __call__(self, person: Person, bus: str, units: Sequence[int], *, parameters: bool) -> None: ...


@dataclass(frozen=True, slots=True)
class _Kept:
    who: str
    bus: str
    action: Action
    fate: asyncio.Task[Result]


class Desk:
    """Takes wishes of people and programs for every bus."""

    def __init__(
        self,
        live: LiveState,
        channels: Mapping[str, Channel],
        events: EventLog,
        database: Database,
        guards: Safeguards,
        now: Callable[[], float] = time.time,
    ) -> None:
        self._live = live
        self._channels = channels
        self._record = Record(events, database, now)
        self._guards = guards
        self._now = now
        self._moves = Moves()
        self._kept: OrderedDict[str, _Kept] = OrderedDict()
        self.before_write: BeforeWrite | None = None
        """Who wants to keep what a unit was, before it is written to."""

    async def ask(
        self,
        person: Person,
        bus: str,
        action: Action,
        *,
        timeout_s: float | None = None,
        confirm: bool = False,
        id: str | None = None,
        origin: str = "api",
        listener: ProgressListener | None = None,
    ) -> Result:
        """Carry out ``action`` and give its one fate; the same ``id`` again gives the same fate.

        ``timeout_s``: how long a write may wait for the wire; :func:`time_for` it when None.

        Raises Problem for what is not asked of the worker at all: 404 for a unit or bus that is not
        configured, 422 ``invalid``, 409 ``dangerous``, ``confirm_needed`` or ``controlled``, 423 ``blocked``.
        """
        live = bus_or_404(self._live, bus)
        for unit in units_named(action):
            unit_or_404(self._live, bus, unit)
        kept = self._kept.get(id) if id is not None else None
        if kept is None and id is not None:
            earlier = await self._record.earlier(id)
            kept = self._kept.get(id)
            if kept is None and earlier is not None:
                _refuse_other(id, earlier.command == command_of(person.account, bus, action))
                return earlier.fate
        if kept is None:
            time_s = time_for(action, live.settings) if timeout_s is None else timeout_s
            deadline = self._now() + time_s
            wish = Wish(id or uuid.uuid4().hex, person, bus, action, deadline, origin, listener)
            await self._check(wish, live, confirm)
            kept = self._start(wish, live)
        _refuse_other(id, (kept.who, kept.bus, kept.action) == (person.account, bus, action))
        return await asyncio.shield(kept.fate)

    async def reserve(self, bus: str) -> None:
        """Somebody who may is about to ask for a write: the next turn of the wire is left to it."""
        if bus in self._channels:
            await self._channels[bus].reserve()

    async def cancel(self, bus: str, id: str) -> None:
        """Give a command up where nothing is half done; its fate still comes to whoever waits."""
        bus_or_404(self._live, bus)
        await self._channels[bus].cancel(id)

    def check(self, person: Person, bus: str, action: Action, *, confirm: bool = False) -> None:
        """The checks of :meth:`ask` alone, for a review. Raises the same Problems."""
        live = bus_or_404(self._live, bus)
        for unit in units_named(action):
            unit_or_404(self._live, bus, unit)
        self._object(person, bus, action, live, confirm)

    async def _check(self, wish: Wish, live: BusLive, confirm: bool) -> None:
        try:
            self._object(wish.person, wish.bus, wish.action, live, confirm)
        except Problem as problem:
            await self._record.reject(wish, live, problem)
            raise

    def _object(self, person: Person, bus: str, action: Action, live: BusLive, confirm: bool) -> None:
        try:
            if is_write(action):
                self._guards.control.use(bus, person.account, self._now())
            check(action, self._circumstances(bus, live, confirm))
        except ControlledError as error:
            detail = "{reason}; nothing was sent"
            raise Problem(
                409, "controlled", detail, params={"reason": error}, outcome="controlled"
            ) from error
        except ObjectionError as error:
            raise _problem(error) from error

    def _circumstances(self, bus: str, live: BusLive, confirm: bool) -> Circumstances:
        return Circumstances(
            bus=live,
            limits=lambda unit: self._guards.limits.of(bus, unit),
            block=lambda unit: self._guards.blocks.of(bus, unit),
            moved=lambda unit: self._moves.within_a_minute(bus, unit, self._now()),
            confirm=confirm,
        )

    def _start(self, wish: Wish, live: BusLive) -> _Kept:
        already = self._kept.get(wish.id)
        if already is not None:
            return already
        # Noted before anybody else can be checked: two at once must not both pass the limit of a minute.
        steps, at = _steps(wish.action, live), self._now()
        for unit, step in steps.items():
            self._moves.note(wish.bus, unit, step, at)
        fate = asyncio.create_task(self._follow(wish, live, steps, at), name=f"command {wish.id}")
        kept = self._kept[wish.id] = _Kept(wish.person.account, wish.bus, wish.action, fate)
        while len(self._kept) > REMEMBERED and next(iter(self._kept.values())).fate.done():
            self._kept.popitem(last=False)
        return kept

    async def _follow(self, wish: Wish, live: BusLive, steps: dict[int, int], at: float) -> Result:
        """Carry it out; its steps, which were noted for ``at``, count no more when no unit acted."""
        acted = False
        try:
            result = await self._carry_out(wish, live)
            acted = result.outcome in ACTED
            return result
        finally:
            for unit, step in () if acted else steps.items():
                self._moves.take_back(wish.bus, unit, step, at)

    async def _carry_out(self, wish: Wish, live: BusLive) -> Result:
        if not is_write(wish.action) and not _is_a_search(wish.action):
            return await self._send(wish, live)
        if self.before_write is not None and is_write(wish.action):
            parameters = isinstance(wish.action, WriteParameter | ChangeBaud)
            units = units_written(wish.action, live)
            await self.before_write(wish.person, wish.bus, units, parameters=parameters)
        intent = await self._record.intend(wish, live)
        result = await self._send(wish, live)
        await self._record.conclude(intent, wish, result)
        return result

    async def _send(self, wish: Wish, live: BusLive) -> Result:
        if live.link.link == "closed":
            message = f"{live.link.cause or 'the port is closed'}; nothing was sent"
            return Result(id=wish.id, at=self._now(), outcome="bus_closed", message=message)
        command = Command(id=wish.id, deadline=wish.deadline, action=wish.action)
        return await self._channels[wish.bus].ask(command, wish.listener)


def _refuse_other(id: str | None, same: bool) -> None:
    if not same:
        detail = "the id '{id}' was used for another command; nothing was sent"
        raise Problem(422, "invalid", detail, params={"id": id}, id=id)


def _is_a_search(action: Action) -> bool:
    """A scan is an event; a look at one address, as a swap takes every few seconds, is not."""
    return isinstance(action, ScanBus) and action.last > action.first


def _steps(action: Action, live: BusLive) -> dict[int, int]:
    if isinstance(action, SetSpeed) and not action.execute:
        return {}
    present = {unit: commanded_setpoint(live.units[unit], live) for unit in live.units}
    return {
        unit: abs(raw - before)
        for unit, raw in setpoints_of(action, live).items()
        if (before := present[unit]) is not None
    }


def _problem(objection: ObjectionError) -> Problem:
    extra: dict[str, Any] = {"outcome": objection.code, "unit": objection.unit}
    if objection.nearest is not None:
        extra["nearest"] = objection.nearest
    detail, params = "{reason}; nothing was sent", {"reason": objection}
    return Problem(STATUS_OF_OBJECTION[objection.code], objection.code, detail, params=params, **extra)
