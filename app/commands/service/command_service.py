"""The one way from a wish to the wire: checked, written down, sent once, followed to its fate."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any, Protocol

import msgspec

from app.commands.authority import Authority, while_permitted
from app.commands.catalogue import kind_of_command
from app.commands.check import check
from app.commands.rules.objection import ObjectionError, RuleContext
from app.commands.rules.setpoint import commanded_setpoint
from app.commands.rules.setpoint_moves import Moves
from app.commands.rules.setpoint_range import kind_of
from app.commands.safeguards.control import ControlledError
from app.commands.safeguards.service import Safeguards
from app.commands.service.command_request import CommandOrigin, CommandRequest, without_secret
from app.commands.service.idempotency_cache import IdempotencyCache, KeptCommand
from app.commands.service.prior_read import UnreadError, read_ranges
from app.commands.service.record import CommandRecord
from app.errors import Problem, StoreError
from app.feed.channel import Channel, ProgressListener
from app.live.command_ids import new_command_id
from app.live.lookup import unit_of_bus_or_404
from app.live.state.bus_live import BusLive
from app.web.access import Person, account_shown
from app.web.deadline import Deadline
from bus.contract import Action, Command, Result
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

STATUS_OF_OBJECTION = {"invalid": 422, "dangerous": 409, "confirm_needed": 409, "blocked": 423}
ACTED = ("verified", "acknowledged", "unverified")
"""Outcomes after which a unit has acted, or may have."""


class WriteSubscriber(Protocol):
    """Called before each write: by whom, to which units, and whether it writes parameters."""

    async def __call__(self, person: Person, units: Sequence[int], *, parameters: bool) -> None: ...


class CommandService:
    """Takes the commands of people and programs for one bus."""

    def __init__(
        self,
        live: BusLive,
        channel: Channel,
        record: CommandRecord,
        cache: IdempotencyCache,
        guards: Safeguards,
        rights: Authority,
        now: Clock = unix_now,
    ) -> None:
        self._live = live
        self._bus = live.settings.name
        self._channel = channel
        self._record = record
        self._cache = cache
        self._guards = guards
        self._rights = rights
        self._now = now
        self._moves = Moves()
        self._under_way: set[asyncio.Task[Result]] = set()
        self._write_subscribers: list[WriteSubscriber] = []

    def on_write(self, subscriber: WriteSubscriber) -> None:
        """Call and await ``subscriber`` before each write; where it raises, nothing is sent."""
        self._write_subscribers.append(subscriber)

    async def ask(
        self,
        person: Person,
        action: Action,
        *,
        deadline: Deadline | None = None,
        timeout_s: float | None = None,
        confirm: bool = False,
        id: str | None = None,
        origin: CommandOrigin | Message = "api",
        listener: ProgressListener | None = None,
    ) -> Result:
        """Carry out ``action`` and give its one fate; the same ``id`` again gives the same fate. It is the
        sender's own: what others ask with the same one is another command.

        ``deadline``: of a command that a request asks for. Without one it may wait ``timeout_s`` from now on,
        or as long as its kind takes.

        Raises Problem for what is not asked of the worker at all: 404 for a unit that is not
        configured, 422 ``invalid``, 409 ``dangerous``, ``confirm_needed`` or ``controlled``, 423 ``blocked``,
        403 ``rights_withdrawn`` when the person's account may no longer do what it could when the person was
        authenticated, 503 ``not_sent`` where its deadline has passed. Work that lasts asks once for each
        write, so that it stops there.
        """
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        id = id or None
        kept = self._cache.find(person, id)
        if kept is None and id is not None:
            earlier = await self._record.earlier(person.sender, id)
            kept = self._cache.find(person, id)
            if kept is None and earlier is not None:
                _refuse_other(id, self._record.is_same(earlier, self._bus, action))
                return msgspec.structs.replace(earlier.result, id=id)
        if kept is None:
            timeout_s = timeout_s or kind_of_command(action).timeout_s(action, self._live)
            deadline = deadline or Deadline.within(timeout_s)
            wish = CommandRequest(
                new_command_id(id), person, self._bus, action, deadline, origin, listener, id
            )
            try:
                await self._check(wish, confirm)
            except UnreadError as unread:
                return unread.result(id or wish.id, self._now(), action.units)
            kept = self._start(wish)
        _refuse_other(id, (kept.bus, kept.action) == (self._bus, action))
        result = await asyncio.shield(kept.result)
        return result if id is None else msgspec.structs.replace(result, id=id)

    async def reserve(self) -> None:
        """A person who may write is about to ask for it: the next turn of the wire is left to it."""
        await self._channel.reserve()

    async def cancel(self, id: str) -> None:
        """Give a command up where nothing is half done; its result still comes."""
        await self._channel.cancel(id)

    async def read_ranges(self, person: Person, action: Action, deadline: Deadline) -> None:
        """Read what bounds the setpoints of ``action`` where it was never read, as :meth:`ask` does.

        Raises Problem 503 or 504 where it cannot be had in time.
        """
        await read_ranges(self.ask, person, self._live, action, self._guards.limits.of, deadline)

    def check(self, person: Person, action: Action, *, confirm: bool = False) -> None:
        """The checks of :meth:`ask` alone, for a review. Raises the same Problems."""
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        self._object(person, action, confirm)

    async def _check(self, wish: CommandRequest, confirm: bool) -> None:
        async with self._rejection_recorded(wish):
            wish.deadline.refuse_passed()
            await self._rights.check(wish.person)
            # Before anything is read for it: who may not write here learns that, not what the unit says.
            self._use_control(wish.person, wish.action)
            await self.read_ranges(wish.person, wish.action, wish.deadline)
            self._object(wish.person, wish.action, confirm)

    @asynccontextmanager
    async def _rejection_recorded(self, wish: CommandRequest) -> AsyncIterator[None]:
        """A write that a Problem ends before anything is sent is an event with its reason."""
        try:
            yield
        except Problem as problem:
            if wish.action.writes:
                await self._record.reject(wish, self._live, problem)
            raise

    def _object(self, person: Person, action: Action, confirm: bool) -> None:
        self._use_control(person, action)
        try:
            check(action, self._circumstances(confirm))
        except ObjectionError as error:
            raise problem_of(error) from error

    def _use_control(self, person: Person, action: Action) -> None:
        try:
            if action.writes:
                self._guards.control.use(person.account, self._now())
        except ControlledError as error:
            raise Problem(
                409, "controlled", Message.of("nothing_sent", reason=error.message), outcome="controlled"
            ) from error

    def _circumstances(self, confirm: bool) -> RuleContext:
        return RuleContext(
            bus=self._live,
            limits=self._guards.limits.of,
            block=self._guards.blocks.of,
            moved=lambda unit: self._moves.within_a_minute(unit, self._now()),
            confirm=confirm,
        )

    def _start(self, wish: CommandRequest) -> KeptCommand:
        already = self._cache.find(wish.person, wish.key)
        if already is not None:
            return already
        # Noted before anybody else can be checked: two at once must not both pass the limit of a minute.
        steps, at = _steps(wish.action, self._live), self._now()
        for unit, step in steps.items():
            self._moves.note(unit, step, at)
        fate = asyncio.create_task(self._follow(wish, steps, at), name=f"command {wish.id}")
        self._under_way.add(fate)
        fate.add_done_callback(self._under_way.discard)
        kept = KeptCommand(self._bus, wish.action, fate)
        if wish.key is not None:
            self._cache.keep(wish.person, wish.key, kept)
        return kept

    async def _follow(self, wish: CommandRequest, steps: dict[int, int], at: UnixTime) -> Result:
        """Carry it out; its steps, which were noted for ``at``, count no more when no unit acted."""
        acted = False
        try:
            result = await self._carry_out(wish)
            acted = result.outcome in ACTED
            return result
        finally:
            for unit, step in () if acted else steps.items():
                self._moves.take_back(unit, step, at)

    async def _carry_out(self, wish: CommandRequest) -> Result:
        kind = kind_of_command(wish.action)
        if not kind.is_event(wish.action):
            return await self._send(wish)
        if wish.action.writes:
            units, parameters = kind.units_written(wish.action, self._live), kind.writes_parameters
            async with self._rejection_recorded(wish):
                for subscriber in self._write_subscribers:
                    await subscriber(wish.person, units, parameters=parameters)
        intent = await self._record.intend(wish, self._live)
        result = without_secret(wish.action, await self._send(wish))
        await self._record.conclude(intent, wish, result)
        return result

    async def _send(self, wish: CommandRequest) -> Result:
        link = self._live.link
        if link.link == "closed":
            refusal = link.refusal
            return Result(id=wish.id, at=self._now(), outcome="bus_closed", message=refusal)
        # Storing the intent and what the unit was may have taken a while on a slow disk.
        reason = await self._why_no_longer(wish)
        if reason is not None:
            return Result(id=wish.id, at=self._now(), outcome="not_sent", message=reason)
        # This clock first: whatever stops this process between the two makes the deadline earlier.
        deadline = self._now() + wish.deadline.left_s
        command = Command(id=wish.id, deadline=deadline, action=wish.action)
        return await while_permitted(
            self._channel.ask(command, wish.listener),
            lambda: self._why_no_longer(wish),
            lambda: self._channel.cancel(wish.id),
        )

    async def _why_no_longer(self, wish: CommandRequest) -> Message | None:
        """Why a command must not be sent, or be given up; None while it may go on. A store that cannot be
        read now ends nothing that is half done."""
        try:
            await self._rights.check(wish.person)
        except Problem as problem:
            return problem.message
        except StoreError:
            return None
        if not wish.action.writes:
            return None
        for unit in kind_of_command(wish.action).units_written(wish.action, self._live):
            block = self._guards.blocks.of(unit)
            if block is not None:
                return Message.of(
                    "unit_blocked", unit=unit, who=account_shown(block.set_by), reason=block.reason
                )
        return self._guards.control.objection(wish.person.account, self._now())


def _refuse_other(id: str | None, same: bool) -> None:
    if not same:
        raise Problem(422, "invalid", Message.of("id_used", id=str(id)), id=id)


def _steps(action: Action, live: BusLive) -> dict[int, int]:
    """By how much it moves the setpoint of each unit, where that is known."""
    steps = {}
    for new in kind_of_command(action).setpoints(action, live):
        unit = live.units[new.unit]
        present = commanded_setpoint(unit, live)
        if present is not None and new.kind in (None, kind_of(unit)) and not new.is_staged:
            steps[new.unit] = abs(new.raw - present)
    return steps


def problem_of(objection: ObjectionError) -> Problem:
    """The refusal of a command by a rule."""
    extra: dict[str, Any] = {"outcome": objection.code, "unit": objection.unit}
    if objection.nearest is not None:
        extra["nearest"] = objection.nearest
    params = {**objection.message.params, "reason": objection.message}
    message = Message("nothing_sent", params)
    return Problem(STATUS_OF_OBJECTION[objection.code], objection.code, message, **extra)
