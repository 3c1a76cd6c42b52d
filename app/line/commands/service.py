"""The service that sends commands to a worker: each is checked, recorded, sent once, and followed to its
result.

There is no other path from a request to the wire.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

from fastapi import Depends
from msgspec.structs import replace
from starlette.requests import HTTPConnection

from app.core.server.turns import FairQueue, TooManyWaitingError
from app.core.web.access import Person, Requires, refuse_without
from app.core.web.arrival import Deadline
from app.core.web.services import bus_service, bus_service_of
from app.errors import Problem, StoreError
from app.line.commands.catalogue import SCAN_BUS, WRITE_PARAMETER, CommandKind, check, kind_of_command
from app.line.commands.control import controlled
from app.line.commands.record import (
    CommandKey,
    CommandOrigin,
    CommandRecord,
    CommandRequest,
    KeptCommand,
    refuse_other,
    without_secret,
)
from app.line.commands.review import present_setpoint
from app.line.commands.rules import (
    Moves,
    RuleContext,
    commanded_setpoint,
    kind_of,
    objection,
    unread_for_range,
)
from app.line.commands.safeguards import Safeguards
from app.line.commands.undo import Undoing
from app.line.commands.values import Scales, parameter_scale, raw_of_percent, setpoint_scale, wording_scales
from app.line.feed.bus_feed import HeldSpeeds
from app.line.feed.channel import Channel, is_reported
from app.line.live.bus_live import BusLive, UnitLive
from app.line.live.requests import new_command_id, unit_of_bus_or_404
from app.people.audit.acts import Act
from app.people.auth.rights import Rights
from bus.catalogue.parameters import DECIMALS, FOLLOWER_MODE, PARAMETERS, RATIO_SETPOINT, Scale
from bus.catalogue.values import is_follower, parameter_raw, ratio_raw, speed_raw
from bus.contract import Action, Command, Outcome, ReadParameters, Result, ScanBus, UnitOutcome, UnitScale
from bus.instants import Monotonic, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message, joined, listed, parameter_name

_ACTED = ("verified", "acknowledged", "unverified")
"""The outcomes after which a unit has acted, or may have."""
_RANGE_PASSES = 2
"""The parameters that bound a setpoint depend on the mode (#8), which may have to be read first."""

MAX_AT_ONCE = 2
"""The most writes of an account at the worker at a time. It carries them out in the order of arrival."""
MAX_WAITING = 60
"""The most writes of an account that wait for their turn."""
END_SCAN = Act("end_scan", SCAN_BUS.role, "bus", "event_scan_ended")
RECHECK_S = 0.25
"""The seconds between checks of the sender's rights: most commands are over by then; a change of the baud
rate or of many units is not."""


BeforeWrite = Callable[[Person, Sequence[int], bool], Awaitable[None]]
"""A function called before each write: who sends it, to which units, whether it writes parameters."""


@dataclass(slots=True)
class AddressScan:
    """A scan of addresses, for whoever opens the page of its bus: ``result`` once it has ended."""

    action: ScanBus
    began_at: UnixTime
    is_under_way: bool = True
    result: Result | None = None


class CommandService:
    """The service that takes the commands of people and programs for one bus."""

    def __init__(
        self,
        live: BusLive,
        channel: Channel,
        record: CommandRecord,
        guards: Safeguards,
        rights: Rights,
        held: HeldSpeeds,
        monotonic: MonotonicClock = monotonic_now,
    ) -> None:
        self._live = live
        self._channel = channel
        self._record = record
        self._guards = guards
        self._rights = rights
        self._held = held
        self._monotonic = monotonic
        self._moves = Moves()
        self._turns: FairQueue[tuple[str, bool]] = FairQueue(inf, MAX_AT_ONCE, MAX_WAITING)
        self._under_way: set[asyncio.Task[Result]] = set()
        self._scans: dict[str, list[Message]] = {}
        """The reasons why each scan under way ends early, by the id of its command."""
        self.last_scan: AddressScan | None = None
        """The scan of addresses that was begun last."""
        self._write_subscribers: list[BeforeWrite] = []
        self.undo = Undoing(live, monotonic)

    @property
    def _bus(self) -> str:
        return self._live.settings.name

    def on_write(self, subscriber: BeforeWrite) -> None:
        """Call and await ``subscriber`` before each write; if it raises, nothing is sent."""
        self._write_subscribers.append(subscriber)

    async def send(
        self,
        person: Person,
        action: Action,
        *,
        deadline: Deadline | None = None,
        confirm: bool = False,
        id: str | CommandKey | None = None,
        origin: CommandOrigin | Message = "api",
        undoes: str = "",
        scales: Scales | None = None,
    ) -> Result:
        """Send ``action`` and return its one result; the same ``id`` returns the same result again. An id
        belongs to its sender: the same id of another sender is another command. It is looked up here, unless
        that was done with :meth:`look_up`.

        ``scales``: those in which its values were shown and typed, unless they were given raw; a unit with
        another scale by now is not written, and the result is *refused*.

        ``deadline``: the request's; without one the command may wait as long as its kind takes.

        Raise Problem for a command that is not sent to the worker: 404 for a unit that is not configured,
        403 ``forbidden`` for a person without the role of its kind, 403 ``rights_withdrawn`` when the account
        has lost a right that it had when the person was authenticated, 422 ``invalid``, 409 ``dangerous``,
        ``confirm_needed`` or ``controlled``, 423 ``blocked``, 503 ``not_sent`` if its deadline has passed. A
        task of many writes sends each as a command and stops there.
        """
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        key = id if isinstance(id, CommandKey) else await self.look_up(person, id or "")
        id, kept = key.id or None, key.kept
        if key.stored is not None:
            earlier = self._record.result_of(key.stored, key.id, self._bus, action)
            return replace(earlier, id=id)
        if kept is None:
            deadline = deadline or Deadline.within(kind_of_command(action).timeout_s(action, self._live))
            request = CommandRequest(
                new_command_id(id), person, self._bus, action, deadline, origin, id, undoes, scales
            )
            try:
                kept = await self._accept(request, confirm)
            except UnreadError as error:
                return error.result(id or request.id, action.units)
        refuse_other(id, same=(kept.bus, kept.action) == (self._bus, action))
        result = await asyncio.shield(kept.result)
        return result if id is None else replace(result, id=id)

    async def look_up(self, person: Person, id: str) -> CommandKey:
        """Look up the command that this person has sent with an id, even before a restart. Pass the key to
        :meth:`send`, which returns the result of that command again."""
        return await self._record.look_up(person, id)

    async def reserve(self) -> None:
        """Reserve the next turn of the wire for a user who may be about to write. On a busy bus the next poll
        leaves within a millisecond of the last one's end: a write that is still on its way through the app
        and onto its disk would wait for one more."""
        await self._channel.reserve()

    async def read_ranges(self, person: Person, action: Action, deadline: Deadline) -> None:
        """Read the bounds of the setpoints of ``action`` if they were never read, as :meth:`send` does.
        Raise Problem 503 or 504 if they cannot be read in time."""
        for _ in range(_RANGE_PASSES):
            missing = self._unread(action)
            if not missing:
                return
            reads = (self.read(person, unit, numbers, deadline) for unit, numbers in missing.items())
            await asyncio.gather(*reads)
        for unit, numbers in self._unread(action).items():
            raise _unread_error(unit, numbers)

    def _unread(self, action: Action) -> dict[int, tuple[int, ...]]:
        """Return by unit the parameters that bound the setpoints of ``action`` and were never read."""
        found = {
            new.unit: unread_for_range(
                self._live.units[new.unit], self._guards.limits(new.unit), new.raw, new.kind
            )
            for new in kind_of_command(action).setpoints(action, self._live)
        }
        return {unit: numbers for unit, numbers in found.items() if numbers}

    async def read(
        self, person: Person, unit: int, numbers: Sequence[int], deadline: Deadline
    ) -> dict[int, int | None]:
        """Return the raw value of each parameter, read now, None if the unit does not have it. Raise Problem
        503 or 504 if one cannot be read in time."""
        action = ReadParameters(unit=unit, numbers=list(numbers))
        result = await self.send(person, action, deadline=deadline)
        if result.outcome == "bus_closed":
            reason = result.message or Message("bus_not_linked")
            raise UnreadError(503, "bus_closed", reason, outcome="bus_closed")
        values = {value.number: value.raw for value in result.values}
        if not values.keys() >= set(numbers):
            raise _unread_error(unit, numbers)
        return values

    async def convert_setpoint(
        self, person: Person, unit: int, text: str, deadline: Deadline
    ) -> tuple[int, UnitScale]:
        """Convert a typed speed or ratio, or percent of the unit's present setpoint, to the integer on the
        wire. Return it with its scale. Raise CallerError for text that is no number."""
        live = self._live.units[unit]
        known = await self._known(person, live, (DECIMALS, FOLLOWER_MODE), deadline)
        decimals = known[DECIMALS]
        if text.rstrip().endswith("%"):
            is_known = live.link.link == "online"
            raw = raw_of_percent(text, present_setpoint(self._live, live) if is_known else None)
        elif is_follower(known[FOLLOWER_MODE]):
            raw = ratio_raw(text)
        elif decimals is None:
            raise Problem(422, "invalid", Message.of("unit_without_decimals", unit=unit), unit=unit)
        else:
            raw = speed_raw(text, decimals)
        return raw, setpoint_scale(live, raw)

    async def convert_parameter(
        self, person: Person, unit: int, number: int, text: str, deadline: Deadline
    ) -> tuple[int, UnitScale]:
        """Convert a typed value of a parameter to the integer on the wire. Return it with its scale. Raise
        CallerError for text that is no number."""
        live, parameter = self._live.units[unit], PARAMETERS[number]
        known = await self._known(person, live, _CONVERTED_WITH.get(parameter.scale, ()), deadline)
        follower = is_follower(known.get(FOLLOWER_MODE)) or number == RATIO_SETPOINT
        raw = parameter_raw(parameter, text, known.get(DECIMALS), follower=follower)
        return raw, parameter_scale(live, number, raw)

    async def _known(
        self, person: Person, unit: UnitLive, numbers: tuple[int, ...], deadline: Deadline
    ) -> dict[int, int | None]:
        """Return these parameters, read now if they are not known or may have changed."""
        missing = [number for number in numbers if not unit.is_current(number)]
        known = {number: unit.parameter_raw(number) for number in numbers}
        return known | (await self.read(person, unit.settings.id, missing, deadline) if missing else {})

    async def check_for_later(self, person: Person, action: Action, deadline: Deadline) -> None:
        """Check a command that is gathered now and sent later: its role, ranges and choices. Bounds that
        cannot be read from a unit now are not judged. Raise Problem as :meth:`send` does."""
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
        """Check a command as :meth:`send` does, for a review or a page, without prolonging control. Raise
        the same Problems."""
        for unit in action.units:
            unit_of_bus_or_404(self._live, unit)
        self._require_right(person, action, self._guards.objection)
        self._apply_rules(action, confirm)

    @asynccontextmanager
    async def _rejection_recorded(self, request: CommandRequest) -> AsyncIterator[None]:
        """Record a write that a Problem ends before anything is sent, with the reason."""
        try:
            yield
        except Problem as problem:
            if request.action.writes:
                await self._record.reject(request, self._live, problem)
            raise

    def _require_right(
        self, person: Person, action: Action, object_to: Callable[[str], Message | None]
    ) -> None:
        """Require the role of the kind, whichever way the command came, then control of the bus."""
        refuse_without(kind_of_command(action).role, person)
        reason = object_to(person.account) if action.writes else None
        if reason is not None:
            raise controlled(Message.of("nothing_sent", reason=reason), self._bus)

    def _apply_rules(self, action: Action, confirm: bool) -> None:
        # A broadcast also reaches units of which nothing is known to be staged.
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
            # This comes before anything is read: a user without the right must not learn the unit's values.
            self._require_right(request.person, request.action, self._guards.use_control)
            self.undo.refuse_over(request)
            await self.read_ranges(request.person, request.action, request.deadline)
            self._apply_rules(request.action, confirm)
        already = self._record.kept(request.person, request.key)
        if already is not None:
            return already
        # This is noted before another command can be checked: two at once must not both pass the minute's
        # limit.
        steps, at = _steps(request.action, self._live), self._monotonic()
        self._moves.note(steps, at)
        task = asyncio.create_task(self._carry_out(request, steps, at), name=f"command {request.id}")
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        kept = KeptCommand(self._bus, request.action, task)
        if request.key is not None:
            self._record.keep(request.person, request.key, kept)
        return kept

    async def _carry_out(self, request: CommandRequest, steps: dict[int, int], at: Monotonic) -> Result:
        """Send a command once its intent is on disk. Its ``steps``, noted for ``at``, no longer count if no
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
                        await subscriber(request.person, units, parameters)
            intent = await self._record.intend(request, self._live)
            write = self.undo.begin(request)
            try:
                result = without_secret(request.action, await self._transmit(request))
            finally:
                self.undo.end(write, request, result)
            await self._record.conclude(intent, request, result, self._live)
            return result
        finally:
            if result is None or result.outcome not in _ACTED:
                self._moves.take_back(steps, at)

    async def _transmit(self, request: CommandRequest) -> Result:
        """Send a command in the turn of its account: however much a program sends, others wait for little of
        it. Commands that only slow units have turns beside the others."""
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
        # Storing the intent and the former values may have taken a while on a slow disk.
        reason = await self._why_no_longer(request, slows=slows)
        if reason is not None:
            return _not_sent(request, reason)
        # The wall clock goes first: a delay of this process between the two makes the deadline earlier.
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
        return await self._follow(command, request, slows=slows)

    async def _follow(self, command: Command, request: CommandRequest, *, slows: bool) -> Result:
        """Send a command and return its result. If it may no longer continue, the worker is told once to stop
        where nothing is half done, and the reason precedes the message of the result."""
        reasons: list[Message] = []
        scan: AddressScan | None = None
        if isinstance(request.action, ScanBus) and SCAN_BUS.is_event(request.action):
            self._scans[request.id] = reasons
            self.last_scan = scan = AddressScan(request.action, unix_now())

        async def watch() -> None:
            reason = await self._why_no_longer(request, slows=slows)
            while reason is None:
                await asyncio.sleep(RECHECK_S)
                reason = await self._why_no_longer(request, slows=slows)
            reasons.append(reason)
            await self._channel.cancel(request.id)

        try:
            with _later(RECHECK_S, watch):
                if command.action.stages:
                    result = await self._stage(command)
                else:
                    result = await self._channel.send(command)
        finally:
            self._scans.pop(request.id, None)
            if scan is not None:
                scan.is_under_way = False
        if reasons:
            result = replace(result, message=joined((*reasons, result.message)))
        if scan is not None:
            scan.result = result
        return result

    async def _stage(self, command: Command) -> Result:
        """Send a command that stages speeds to the worker, once its units are on disk."""
        units = command.action.stages
        try:
            async with self._held.staging(units):
                result = await self._channel.send(command)
                if not is_reported(result):
                    self._held.show_unknown(units)
        except StoreError as error:
            return Result(id=command.id, at=unix_now(), outcome="not_sent", message=error.message)
        return result

    async def end_scans(self, person: Person) -> bool:
        """End the scans of the bus after the address under way; the result of each names the person. Return
        whether there was one. Raise Problem 403."""
        END_SCAN.check(person)
        ended = {id: reasons for id, reasons in self._scans.items() if not reasons}
        for id, reasons in ended.items():
            reasons.append(Message.of("scan_ended_by", who=person.name))
            await self._channel.cancel(id)
        if ended:
            await self._record.note(END_SCAN, person, self._bus)
        return bool(ended)

    async def _why_no_longer(self, request: CommandRequest, *, slows: bool) -> Message | None:
        """Return why a command must not be sent, or be given up; None while it may continue. A store that
        cannot be read now ends nothing that is half done. ``slows``: whether the command could only make
        units slower when it was sent."""
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


@contextmanager
def _later(seconds: float, work: Callable[[], Coroutine[Any, Any, None]]) -> Iterator[None]:
    """Begin ``work`` after a delay in seconds; cancel it as the context ends: most never begins."""
    begun: list[asyncio.Task[None]] = []
    timer = asyncio.get_running_loop().call_later(seconds, lambda: begun.append(asyncio.create_task(work())))
    try:
        yield
    finally:
        timer.cancel()
        for task in begun:
            task.cancel()


def _not_sent(request: CommandRequest, reason: Message) -> Result:
    return Result(id=request.id, at=unix_now(), outcome="not_sent", message=reason)


_CONVERTED_WITH = {Scale.SPEED: (DECIMALS,), Scale.SPEED_OR_RATIO: (DECIMALS, FOLLOWER_MODE)}


class UnreadError(Problem):
    """Raised when a parameter that a command depends on cannot be read: 503 ``bus_closed`` or 504
    ``unverified``."""

    def result(self, id: str, units: Sequence[int]) -> Result:
        """Return the result of a command for ``units`` of which nothing was sent."""
        outcome: Outcome = "bus_closed" if self.code == "bus_closed" else "unverified"
        parts = [UnitOutcome(unit, "not_sent", Message("unit_untouched")) for unit in units]
        return Result(id, unix_now(), outcome, self.message, units=parts)


def _unread_error(unit: int, numbers: Sequence[int]) -> UnreadError:
    named = listed([parameter_name(number) for number in numbers])
    message = Message.of("unit_gave_too_little", unit=unit, numbers=named)
    return UnreadError(504, "unverified", message, outcome="unverified", unit=unit)


def check_all_read(unit: int, numbers: Sequence[int], result: Result) -> None:
    """Raise Problem 504 if the unit did not return all the requested ``numbers``, 503 if the request did not
    reach it."""
    if len(result.values) < len(numbers):
        status = 503 if result.outcome in ("bus_closed", "not_sent") else 504
        code = result.outcome if status == 503 else "unverified"
        detail = result.message or Message.of("unit_did_not_answer", unit=unit)
        raise Problem(status, code, detail, outcome=code, unit=unit, read=len(result.values))


def _steps(action: Action, live: BusLive) -> dict[int, int]:
    """Return how far a command moves the setpoint of each unit, if that is known."""
    steps = {}
    for new in kind_of_command(action).setpoints(action, live):
        unit = live.units[new.unit]
        present = commanded_setpoint(unit, live)
        if present is not None and new.kind in (None, kind_of(unit)) and not new.is_staged:
            steps[new.unit] = abs(new.raw - present)
    return steps


Commands = Annotated[CommandService, bus_service(CommandService)]
"""The service that sends commands to ``{bus}`` in the path."""


class RequiresWrite(Requires):
    """A dependency that reserves the next turn of ``{bus}`` in the path for a user with the role.

    The lateness of a command is judged where it is sent: it may have a timeout of its own, and one that was
    carried out before returns its result however late it is repeated.
    """

    async def grant(self, connection: HTTPConnection) -> Person:
        person = self.permitted(connection)
        if "bus" in connection.path_params:
            await bus_service_of(connection, connection.path_params["bus"], CommandService).reserve()
        return person


def permitted(kind: CommandKind[Any]) -> Any:
    """Make a dependency that requires the role of a kind of command."""
    return Depends(Requires(kind.role, kind.request.__name__))


ParameterWriter = Annotated[Person, permitted(WRITE_PARAMETER)]
"""The person who may write parameters: of one unit, of many, by a restore or in a unit swap."""


def permitted_writer(kind: CommandKind[Any]) -> Any:
    """Make a dependency that requires the role of a kind of command, and reserves a turn of the wire."""
    return Depends(RequiresWrite(kind.role, kind.request.__name__))
