"""Limits, blocks and control of one bus: what keeps a command from being sent. Every change is an event."""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import InitVar, dataclass, field

from app.core.database import Database
from app.core.web.admission.access import Person, Role, name_of
from app.core.web.admission.rate_limit import RateLimit
from app.core.web.rendering.head_control import BusControl
from app.errors import Problem
from app.line.commands.acts import (
    BLOCK,
    END_CONTROL_REQUEST,
    END_READ_ONLY,
    FORCE_CONTROL,
    GRANT_CONTROL,
    HAND_OVER_CONTROL,
    RELEASE_CONTROL,
    REQUEST_CONTROL,
    SET_LIMITS,
    SET_READ_ONLY,
    TAKE_CONTROL,
    UNBLOCK,
)
from app.line.commands.safeguards.control import Control, Holding, RequestedControl, controlled
from app.line.commands.safeguards.limits import BlockStore, CommandBlock, Limits, LimitsStore
from app.line.commands.safeguards.read_only import ReadOnly, ReadOnlyStore
from app.line.live.screen.sources import UnitSubscriber
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.people.auth.rights.rights import Rights
from bus.bucket import Bucket
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message, term

SIGNED_OUT = Message("holder_signed_out")
REQUEST_EVERY_S, MAX_REQUESTS = 10.0, 6
"""How often control of a bus is requested, and how often at once: each request disturbs a person."""
AccountLookup = Callable[[str], Awaitable[tuple[str, Role] | None]]
"""The account with this name, and its role; None where there is none."""


@dataclass(eq=False, repr=False)
class Safeguards:
    """The safeguards of one bus. Call :meth:`load` once before the first command."""

    _bus: str
    _units: Iterable[int]
    database: InitVar[Database]
    _events: EventLog
    control_required: InitVar[bool]
    find: AccountLookup
    rights: Rights
    _block_subscribers: list[UnitSubscriber] = field(default_factory=list)
    _control_subscribers: list[Callable[[], None]] = field(default_factory=list)
    _read_only_ends: asyncio.TimerHandle | None = None
    _requests: defaultdict[str, Bucket] = field(
        default_factory=lambda: defaultdict(lambda: Bucket(1 / REQUEST_EVERY_S, MAX_REQUESTS))
    )
    """By account."""

    def __post_init__(self, database: Database, control_required: bool) -> None:
        self.limits = LimitsStore(database, self._bus)
        self.blocks = BlockStore(database, self._bus)
        self.read_only = ReadOnlyStore(database, self._bus)
        self.control = Control(required=control_required)
        self.rights.on_withdrawn(self.revoke_control)

    async def load(self) -> None:
        """Read limits and blocks, and free control."""
        self.control = Control(required=self.control.required)
        await self.limits.load()
        await self.blocks.load()
        await self.read_only.load(unix_now(), monotonic_now())
        self._publish_read_only()

    def on_block(self, subscriber: UnitSubscriber) -> None:
        """Call ``subscriber`` when a unit was blocked or freed."""
        self._block_subscribers.append(subscriber)

    def on_control(self, subscriber: Callable[[], None]) -> None:
        """Call ``subscriber`` when control has another holder, or was requested."""
        self._control_subscribers.append(subscriber)

    def read_only_now(self) -> ReadOnly | None:
        """Why no command is sent to the bus, and by whom that was set; None where commands are sent."""
        return self.read_only.of(monotonic_now())

    def block_reason(self, unit: int, *, slows: bool = False) -> Message | None:
        """Why a unit or its bus takes no command, and by whom; None where it does. ``slows``: the command can
        only make the unit slower, so that a read-only bus takes it."""
        block = (None if slows else self.read_only_now()) or self.blocks.of(unit)
        return None if block is None else Message.of("block_by", reason=block.reason, who=block.set_by)

    async def set_limits(self, person: Person, unit: int, limits: Limits) -> None:
        """Replace the limits of a unit. Raises Problem 403."""
        SET_LIMITS.check(person)
        before = self.limits.of(unit)
        await self.limits.put(unit, limits, person.name, unix_now())
        await self._record(SET_LIMITS, person, before.message, limits.message, unit)

    async def block(self, person: Person, unit: int, reason: str) -> None:
        """Refuse every write to a unit from now on. Raises Problem 403."""
        BLOCK.check(person)
        before = self.blocks.of(unit)
        await self.blocks.put(unit, CommandBlock(reason, person.name, unix_now()))
        self._publish_block(unit)
        old = before.reason if before is not None else None
        await self._record(BLOCK, person, old, reason, unit)

    async def lift(self, person: Person, unit: int) -> None:
        """Free a unit. Nothing happens to one that is free. Raises Problem 403."""
        UNBLOCK.check(person)
        before = self.blocks.of(unit)
        if before is None:
            return
        await self.blocks.lift(unit)
        self._publish_block(unit)
        await self._record(UNBLOCK, person, before.reason, None, unit)

    async def set_read_only(self, person: Person, reason: str, minutes: int | None) -> None:
        """Refuse every write that could do more than slow a unit, for so many minutes, or until it is ended.
        Raises Problem 403."""
        SET_READ_ONLY.check(person)
        before, now = self.read_only_now(), unix_now()
        until = None if minutes is None else now + 60 * minutes
        await self.read_only.put(ReadOnly(reason, person.name, now, until), monotonic_now())
        self._publish_read_only()
        new = Message.of("read_only_for", reason=reason, n=minutes) if minutes is not None else reason
        await self._record(SET_READ_ONLY, person, before.reason if before is not None else None, new)

    async def end_read_only(self, person: Person) -> None:
        """Let commands through again. Nothing happens where they are not kept. Raises Problem 403."""
        END_READ_ONLY.check(person)
        before = self.read_only_now()
        if before is None:
            return
        await self.read_only.end()
        self._publish_read_only()
        await self._record(END_READ_ONLY, person, before.reason, None)

    def holding(self) -> Holding | None:
        """The holder of control; None where it is free."""
        return self.control.holding(monotonic_now())

    def lapses_at(self, holding: Holding) -> UnixTime:
        """When control lapses by the wall clock, as that is now, unless its holder sends another command."""
        return unix_now() + holding.left_s(monotonic_now())

    def objection(self, account: str) -> Message | None:
        """Why ``account`` may not write now, as another has control; None where it may."""
        return self.control.objection(account, monotonic_now())

    def use_control(self, account: str) -> Message | None:
        """Renew control for a write; the same as :meth:`objection` where another has control."""
        return self.control.use(account, monotonic_now())

    def holder(self) -> str:
        """The account of the holder; empty where control is free."""
        holding = self.holding()
        return holding.holder if holding is not None else ""

    def bus_control(self) -> BusControl:
        """Control of the bus as every page shows it."""
        now, holding = monotonic_now(), self.holding()
        if holding is None:
            return BusControl(self._bus)
        request = self.control.request_now(now)
        shown = BusControl(self._bus, holding.holder, holding.since, self.lapses_at(holding))
        if request is None:
            return shown
        return shown.requested(request.by, request.state(now), unix_now() + request.left_s(now))

    async def take(self, person: Person) -> Holding:
        """Take control, if it is free. Raises Problem 403 and 409."""
        TAKE_CONTROL.check(person)
        await self.rights.check(person)
        before = self.holding()
        holding = self.control.take(person.account, monotonic_now(), unix_now())
        if before is None:
            self._publish_control()
            await self._record(TAKE_CONTROL, person, None, person.account)
        return holding

    async def request(self, person: Person) -> RequestedControl | None:
        """Request control from its holder, on every page that the holder has open. Raises Problem 403, 409,
        and 429 after too many requests of this account."""
        REQUEST_CONTROL.check(person)
        await self.rights.check(person)
        now, bucket = monotonic_now(), self._requests[person.account]
        if not bucket.has_room(now):
            seconds = math.ceil(bucket.wait_s(now))
            problem = Problem(429, "too_many", Message.of("control_requests_too_many", n=seconds))
            problem.headers.update(self.request_limit(person).headers)
            raise problem.with_headers(Retry_After=str(seconds))
        if self.control.request(person.account, now):
            bucket.take(now)
            self._publish_control()
            await self._record(REQUEST_CONTROL, person, self.holder(), person.account)
        return self.control.request_now(now)

    def request_limit(self, person: Person) -> RateLimit:
        """How many more requests of control of this bus are taken of a person now."""
        return RateLimit.of(self._requests[person.account], monotonic_now())

    async def grant(self, person: Person, shown: str | None = None) -> Holding:
        """Hand control over to the account that has requested it. ``shown``: whose request the person saw;
        None: whichever is open. Raises Problem 403, 409, and 422 where that account may command the bus no
        longer."""
        GRANT_CONTROL.check(person)
        await self.rights.check(person)
        to = self.control.requester(person.account, monotonic_now())
        self._refuse_other_request(shown)
        if await self._who_may_hold(person, to) != to:
            raise Problem(422, "invalid", Message.of("holder_cannot_sign_in", name=to))
        if self.control.requester(person.account, monotonic_now()) != to:
            raise controlled(Message("control_not_requested"))
        holding = self.control.hand_over(person.account, to, monotonic_now(), unix_now())
        self._publish_control()
        await self._record(GRANT_CONTROL, person, person.account, to)
        return holding

    async def end_request(self, person: Person, shown: str | None = None) -> None:
        """Decline the open request as the holder, or withdraw it as its account; ``shown`` as of
        :meth:`grant`. Raises Problem 403, 409."""
        END_CONTROL_REQUEST.check(person)
        await self.rights.check(person)
        self._refuse_other_request(shown)
        request = self.control.end_request(person.account, monotonic_now())
        self._publish_control()
        withdrawn = request.by == person.account
        result = Message("control_withdrawn" if withdrawn else "control_declined")
        await self._record(END_CONTROL_REQUEST, person, request.by, result)

    def _refuse_other_request(self, shown: str | None) -> None:
        request = self.control.request_now(monotonic_now())
        if shown is not None and request is not None and request.by != shown:
            raise controlled(Message("control_not_requested"))

    async def hand_over(self, person: Person, to: str) -> Holding:
        """Hand control over; an admin may do so without holding it. Raises Problem 403, 409, and 422 for a
        name without an account that could use it, which would hold the line until it lapses."""
        HAND_OVER_CONTROL.check(person)
        to = await self._who_may_hold(person, to)
        before = self.holding()
        by_force = person.role.includes(FORCE_CONTROL.role)
        holding = self.control.hand_over(person.account, to, monotonic_now(), unix_now(), by_force=by_force)
        self._publish_control()
        old = before.holder if before is not None else None
        await self._record(HAND_OVER_CONTROL, person, old, to)
        return holding

    async def _who_may_hold(self, person: Person, to: str) -> str:
        found = (to, person.role) if to == person.account else await self.find(to)
        if found is None:
            raise Problem(422, "invalid", Message.of("holder_cannot_sign_in", name=to))
        account, role = found
        if not role.includes(TAKE_CONTROL.role):
            raise Problem(422, "invalid", Message.of("holder_may_not_command", name=to, role=term(role)))
        return account

    async def release(self, person: Person) -> None:
        """Release control. Raises Problem 403 and 409."""
        RELEASE_CONTROL.check(person)
        self.control.release(person.account, monotonic_now())
        self._publish_control()
        await self._record(RELEASE_CONTROL, person, person.account, None)

    async def revoke_control(self, account: str) -> None:
        """The account is signed in nowhere any more, or may do less: what it held is free."""
        held = self.control.revoke(account, monotonic_now())
        self._publish_control()
        if not held:
            return
        who, is_token = name_of(account)
        await self._events.record(
            kind=RELEASE_CONTROL.kind,
            what=Message(RELEASE_CONTROL.event),
            who=who,
            origin="token" if is_token else "",
            bus=self._bus,
            old=account,
            message=SIGNED_OUT,
        )

    def _publish_block(self, unit: int) -> None:
        for subscriber in self._block_subscribers:
            subscriber(unit)

    def _publish_read_only(self) -> None:
        """Show every unit as it is now, and again when the duration of the mode is over."""
        if self._read_only_ends is not None:
            self._read_only_ends.cancel()
        left_s = self.read_only.left_s(monotonic_now())
        if 0 < left_s < math.inf:
            loop = asyncio.get_running_loop()
            self._read_only_ends = loop.call_later(left_s, self._publish_read_only)
        for unit in self._units:
            self._publish_block(unit)

    def _publish_control(self) -> None:
        for subscriber in self._control_subscribers:
            subscriber()

    async def _record(
        self,
        act: Act,
        person: Person,
        old: str | Message | None,
        new: str | Message | None,
        unit: int | None = None,
    ) -> None:
        await self._events.record(**act.by(person), bus=self._bus, unit=unit, old=old, new=new)
