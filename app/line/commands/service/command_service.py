"""The only path from a request to the wire: checked, recorded, sent once, followed to its result."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, field
from math import inf
from typing import Any, Protocol

import msgspec

from app.core.server.turns import FairQueue, TooManyWaitingError
from app.core.web.access import Person, refuse_without
from app.core.web.arrival import Deadline
from app.errors import Problem, StoreError
from app.line.commands.catalogue import check, kind_of_command
from app.line.commands.control import controlled
from app.line.commands.rules import Moves, RuleContext, commanded_setpoint, kind_of, objection
from app.line.commands.safeguards import Safeguards
from app.line.commands.service.command_request import CommandOrigin, CommandRequest, without_secret
from app.line.commands.service.idempotency import CommandKey, IdempotencyCache, KeptCommand, refuse_other
from app.line.commands.service.prior_read import UnreadError, read_values, unread, unread_by_unit
from app.line.commands.service.record import CommandRecord
from app.line.commands.service.undoing import Undoing
from app.line.commands.values import Scales, wording_scales
from app.line.feed.channel import Channel
from app.line.live.bus_live import BusLive
from app.line.live.requests import new_command_id, unit_of_bus_or_404
from app.people.auth.rights import Rights
from bus.contract import Action, Command, ReadParameters, Result
from bus.instants import Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message, joined

ACTED = ("verified", "acknowledged", "unverified")
"""Outcomes after which a unit has acted, or may have."""
RANGE_PASSES = 2
"""Which parameters bound a setpoint depends on the mode (#8), which may have to be read itself."""

MAX_AT_ONCE = 2
"""Writes of an account that the worker has at a time. It carries them out in the order in which they come."""
MAX_WAITING = 60
"""Writes of an account that may wait for that."""
RECHECK_S = 0.25
"""How often the rights of the sender are looked at: most commands are over by then; a change of the baud rate
or of many units is not."""


class WriteSubscriber(Protocol):
    """Called before each write: by whom, to which units, and whether it writes parameters."""

    async def __call__(self, person: Person, units: Sequence[int], *, parameters: bool) -> None: ...


@dataclass(eq=False, repr=False)
class CommandService:
    """Takes the commands of people and programs for one bus."""

    _live: BusLive
    _channel: Channel
    _record: CommandRecord
    _cache: IdempotencyCache
    _guards: Safeguards
    _rights: Rights
    _monotonic: MonotonicClock = monotonic_now
    _moves: Moves = field(default_factory=Moves)
    _turns: FairQueue[tuple[str, bool]] = field(
        default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING)
    )
    _under_way: set[asyncio.Task[Result]] = field(default_factory=set)
    _write_subscribers: list[WriteSubscriber] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.undo = Undoing(self._live, self._monotonic)

    @property
    def _bus(self) -> str:
        return self._live.settings.name

    def on_write(self, subscriber: WriteSubscriber) -> None:
        """Call and await ``subscriber`` before each write; where it raises, nothing is sent."""
        self._write_subscribers.append(subscriber)

    async def send(
        self,
        person: Person,
        action: Action,
        *,
        deadline: Deadline | None = None,
        timeout_s: float | None = None,
        confirm: bool = False,
        id: str | CommandKey | None = None,
        origin: CommandOrigin | Message = "api",
        undoes: str = "",
        scales: Scales | None = None,
    ) -> Result:
        """Send ``action`` and return its one result; the same ``id`` returns the same result again. An id
        belongs to its sender: the same id of another sender is another command. It is looked up here, unless
        that was done with `look_up`.

        ``scales``: what its values were shown and typed with, where they were not given raw; a unit that has
        another scale by now is not written, and the result is *refused*.

        ``deadline``: the request's. Without one it may wait ``timeout_s`` from now, or as long as its
        kind takes.

        Raises Problem for a command that is not sent to the worker: 404 for a unit that is not
        configured, 403 ``forbidden`` for a person without the role of its kind, 403 ``rights_withdrawn`` when
        the account has lost a right that it had when the person was authenticated, 422 ``invalid``, 409
        ``dangerous``, ``confirm_needed`` or ``controlled``, 423 ``blocked``, 503 ``not_sent`` where its
        deadline has passed. A task of many writes sends each as a command and stops there.
        """
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        key = id if isinstance(id, CommandKey) else await self.look_up(person, id or "")
        id, kept = key.id or None, key.kept
        if key.stored is not None:
            earlier = self._record.result_of(key.stored, key.id, self._bus, action)
            return msgspec.structs.replace(earlier, id=id)
        if kept is None:
            timeout_s = timeout_s or kind_of_command(action).timeout_s(action, self._live)
            deadline = deadline or Deadline.within(timeout_s)
            request = CommandRequest(
                new_command_id(id), person, self._bus, action, deadline, origin, id, undoes, scales
            )
            try:
                kept = await self._accept(request, confirm)
            except UnreadError as error:
                return error.result(id or request.id, unix_now(), action.units)
        refuse_other(id, same=(kept.bus, kept.action) == (self._bus, action))
        result = await asyncio.shield(kept.result)
        return result if id is None else msgspec.structs.replace(result, id=id)

    async def look_up(self, person: Person, id: str) -> CommandKey:
        """Look up the command that this person has sent with an id, also before a restart; an empty id names
        none. Pass the key to :meth:`send`, which gives the result of that command again."""
        kept = self._cache.find(person, id)
        if kept is not None or not id:
            return CommandKey(id, kept)
        stored = await self._record.earlier(person, id)
        kept = self._cache.find(person, id)
        return CommandKey(id, kept, None if kept is not None else stored)

    async def reserve(self) -> None:
        """A user may be about to write: reserve the next turn of the wire."""
        await self._channel.reserve()

    async def read_ranges(self, person: Person, action: Action, deadline: Deadline) -> None:
        """Read what bounds the setpoints of ``action`` where it was never read, as :meth:`send` does.

        Raises Problem 503 or 504 where it cannot be had in time.
        """
        for _ in range(RANGE_PASSES):
            missing = unread_by_unit(self._live, action, self._guards.limits)
            if not missing:
                return
            reads = (self.read(person, unit, numbers, deadline) for unit, numbers in missing.items())
            await asyncio.gather(*reads)
        for unit, numbers in unread_by_unit(self._live, action, self._guards.limits).items():
            raise unread(unit, numbers)

    async def read(
        self, person: Person, unit: int, numbers: Sequence[int], deadline: Deadline
    ) -> dict[int, int | None]:
        """The raw value of each parameter as the unit gives it now, None where it does not have it.

        Raises Problem 503 or 504 where one cannot be had in time.
        """
        action = ReadParameters(unit=unit, numbers=list(numbers))
        return read_values(unit, numbers, await self.send(person, action, deadline=deadline))

    async def check_for_later(self, person: Person, action: Action, deadline: Deadline) -> None:
        """The checks of a command that is gathered now and sent later: its role, ranges and choices. What
        cannot be read of a unit now is not judged. Raises Problem as :meth:`send` does."""
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        refuse_without(kind_of_command(action).role, person)
        with suppress(Problem):
            await self.read_ranges(person, action, deadline)
        anytime = RuleContext(
            self._live, self._guards.limits, block=lambda _: None, moved=lambda _: 0, confirm=True
        )
        check(action, anytime)

    def check(self, person: Person, action: Action, *, confirm: bool = False) -> None:
        """The checks of :meth:`send` alone, for a review or a page: they prolong no control. Raises the same
        Problems."""
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        self._require_right(person, action, self._guards.objection)
        self._apply_rules(action, confirm)

    @asynccontextmanager
    async def _rejection_recorded(self, request: CommandRequest) -> AsyncIterator[None]:
        """A write that a Problem ends before anything is sent is an event with its reason."""
        try:
            yield
        except Problem as problem:
            if request.action.writes:
                await self._record.reject(request, self._live, problem)
            raise

    def _require_right(
        self, person: Person, action: Action, object_to: Callable[[str], Message | None]
    ) -> None:
        """The role of the kind, whichever way the command came, then control of the bus."""
        refuse_without(kind_of_command(action).role, person)
        objection = object_to(person.account) if action.writes else None
        if objection is not None:
            raise controlled(Message.of("nothing_sent", reason=objection), self._bus)

    def _apply_rules(self, action: Action, confirm: bool) -> None:
        # A broadcast reaches units of which nothing is known to be staged, too.
        slows = kind_of_command(action).only_slows(action, self._live)
        mode = self._guards.read_only() if action.writes and not slows else None
        if mode is not None:
            raise objection("blocked", mode.refusal())
        context = RuleContext(
            bus=self._live,
            limits=self._guards.limits,
            block=self._guards.block_of,
            moved=lambda unit: self._moves.within_a_minute(unit, self._monotonic()),
            confirm=confirm,
        )
        check(action, context)

    async def _accept(self, request: CommandRequest, confirm: bool) -> KeptCommand:
        """Check a command and start it, unless another request with its key has done so meanwhile."""
        async with self._rejection_recorded(request):
            request.deadline.refuse_passed()
            await self._rights.check(request.person)
            # Before anything is read for it: a user without the right learns that, not the unit's values.
            self._require_right(request.person, request.action, self._guards.use_control)
            self.undo.refuse_over(request)
            await self.read_ranges(request.person, request.action, request.deadline)
            self._apply_rules(request.action, confirm)
        already = self._cache.find(request.person, request.key)
        if already is not None:
            return already
        # Noted before another command can be checked: two at once must not both pass the limit of a minute.
        steps, at = _steps(request.action, self._live), self._monotonic()
        self._moves.note(steps, at)
        task = asyncio.create_task(self._carry_out(request, steps, at), name=f"command {request.id}")
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        kept = KeptCommand(self._bus, request.action, task)
        if request.key is not None:
            self._cache.keep(request.person, request.key, kept)
        return kept

    async def _carry_out(self, request: CommandRequest, steps: dict[int, int], at: Monotonic) -> Result:
        """Send a command once its intent is on disk. Its ``steps``, noted for ``at``, count no more where no
        unit acted."""
        kind = kind_of_command(request.action)
        result: Result | None = None
        try:
            if not kind.is_event(request.action):
                result = await self._transmit(request)
                return result
            if request.action.writes:
                units, parameters = kind.units_written(request.action, self._live), kind.writes_parameters
                async with self._rejection_recorded(request):
                    for subscriber in self._write_subscribers:
                        await subscriber(request.person, units, parameters=parameters)
            intent = await self._record.intend(request, self._live)
            with self.undo.of(request) as followed:
                result = followed(without_secret(request.action, await self._transmit(request)))
            await self._record.conclude(intent, request, result, self._live)
            return result
        finally:
            if result is None or result.outcome not in ACTED:
                self._moves.take_back(steps, at)

    async def _transmit(self, request: CommandRequest) -> Result:
        """Send it in the turn of its account: however much a program sends, others wait for little of it.
        What only slows has turns beside what does not."""
        slows = kind_of_command(request.action).only_slows(request.action, self._live)
        if not request.action.writes:
            return await self._send_now(request, slows=slows)
        async with AsyncExitStack() as turn:
            try:
                async with asyncio.timeout(request.deadline.left_s):
                    await turn.enter_async_context(self._turns.turn((request.person.account, slows)))
            except TimeoutError:
                return _not_sent(request, Message("deadline_passed"))
            except TooManyWaitingError:
                return _not_sent(request, Message("too_many_commands"))
            return await self._send_now(request, slows=slows)

    async def _send_now(self, request: CommandRequest, *, slows: bool) -> Result:
        link = self._live.link
        if link.link == "closed":
            refusal = link.refusal
            return Result(id=request.id, at=unix_now(), outcome="bus_closed", message=refusal)
        # Storing the intent and what the unit was may have taken a while on a slow disk.
        reason = await self._why_no_longer(request, slows=slows)
        if reason is not None:
            return _not_sent(request, reason)
        # This clock first: whatever stops this process between the two makes the deadline earlier.
        deadline = unix_now() + request.deadline.left_s
        typed = request.scales is not None
        scales = wording_scales(request.action, self._live) if request.scales is None else request.scales
        command = Command(
            id=request.id,
            deadline=deadline,
            action=request.action,
            scales={unit: scale for unit, scale in scales.items() if scale},
            typed=typed,
        )
        return await _while_permitted(
            self._channel.send(command),
            lambda: self._why_no_longer(request, slows=slows),
            lambda: self._channel.cancel(request.id),
        )

    async def _why_no_longer(self, request: CommandRequest, *, slows: bool) -> Message | None:
        """Why a command must not be sent, or be given up; None while it may go on. A store that cannot be
        read now ends nothing that is half done. ``slows``: it could only make units slower when it was
        sent."""
        try:
            await self._rights.check(request.person)
        except Problem as problem:
            return problem.message
        except StoreError:
            return None
        if not request.action.writes:
            return None
        if not slows and (mode := self._guards.read_only()) is not None:
            return mode.refusal()
        for unit in kind_of_command(request.action).units_written(request.action, self._live):
            block = self._guards.block_of(unit)
            if block is not None:
                return block.refusal(unit)
        return self._guards.objection(request.person.account)


def _not_sent(request: CommandRequest, reason: Message) -> Result:
    return Result(id=request.id, at=unix_now(), outcome="not_sent", message=reason)


def _steps(action: Action, live: BusLive) -> dict[int, int]:
    """By how much it moves the setpoint of each unit, where that is known."""
    steps = {}
    for new in kind_of_command(action).setpoints(action, live):
        unit = live.units[new.unit]
        present = commanded_setpoint(unit, live)
        if present is not None and new.kind in (None, kind_of(unit)) and not new.is_staged:
            steps[new.unit] = abs(new.raw - present)
    return steps


async def _while_permitted(
    work: Coroutine[Any, Any, Result],
    why_not: Callable[[], Awaitable[Message | None]],
    give_up: Callable[[], Awaitable[None]],
) -> Result:
    """Return the result of ``work``, a command in progress. When ``why_not`` gives a reason, ``give_up`` is
    called once, the worker stops where nothing is half done, and the reason precedes the result's message."""
    task = asyncio.ensure_future(work)
    reason: Message | None = None
    try:
        while not task.done():
            await asyncio.wait({task}, timeout=RECHECK_S)
            if not task.done() and reason is None:
                reason = await why_not()
                if reason is not None:
                    await give_up()
        result = task.result()
    finally:
        task.cancel()
    return msgspec.structs.replace(result, message=joined((reason, result.message)))
