"""The safeguards of one bus, which keep commands from being sent: limits, blocks, control. Each change is an
event."""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace

from app.core.database import Database
from app.core.web.access import Person, Role, name_of
from app.core.web.routes import RateLimit
from app.errors import Problem
from app.line.commands.control import Control, Holding, controlled
from app.line.commands.limits import CommandBlock, Limits, ReadOnly, Restrictions
from app.line.live.sources import BusControl
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from app.people.auth.rights import Rights
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message, term
from bus.pacing import Bucket

SET_LIMITS = Act("set_speed_limits", Role.ENGINEER, "limits", "event_limits_changed")
BLOCK = Act("block_commands", Role.OPERATOR, "block", "event_unit_blocked")
UNBLOCK = Act("unblock_commands", Role.OPERATOR, "block", "event_block_lifted")
SET_READ_ONLY = Act("set_read_only", Role.ADMIN, "block", "event_read_only_set")
END_READ_ONLY = Act("end_read_only", Role.ADMIN, "block", "event_read_only_ended")
TAKE_CONTROL = Act("take_control", Role.OPERATOR, "control", "event_control_taken")
HAND_OVER_CONTROL = Act("hand_over_control", Role.OPERATOR, "control", "event_control_handed_over")
FORCE_CONTROL = Act("force_control", Role.ADMIN, "control", "event_control_handed_over")
"""The act of handing over control that another user holds."""
RELEASE_CONTROL = Act("release_control", Role.OPERATOR, "control", "event_control_given_back", counted=False)
REQUEST_CONTROL = Act("request_control", Role.OPERATOR, "control", "event_control_requested")
GRANT_CONTROL = Act("grant_control", Role.OPERATOR, "control", "event_control_handed_over")
"""The act of handing over to the account that has requested control."""
END_CONTROL_REQUEST = Act("end_control_request", Role.OPERATOR, "control", "event_control_request_ended")
"""The act of declining a request, by the holder, or of withdrawing it."""
ACTS = (
    *(SET_LIMITS, BLOCK, UNBLOCK, SET_READ_ONLY, END_READ_ONLY),
    *(TAKE_CONTROL, HAND_OVER_CONTROL, FORCE_CONTROL, RELEASE_CONTROL),
    *(REQUEST_CONTROL, GRANT_CONTROL, END_CONTROL_REQUEST),
)
SIGNED_OUT = Message("holder_signed_out")
LIFTED_SHOWN_S = 60.0
REQUEST_EVERY_S, MAX_REQUESTS = 10.0, 6
"""The rate of requests for control of a bus, and the most at once: each one disturbs a person."""
AccountLookup = Callable[[str], Awaitable[tuple[str, Role] | None]]
"""A function that finds the account with a name, and its role; None if there is none."""


class Safeguards:
    """The restrictions and the control of one bus. Call :meth:`load` once before the first command."""

    def __init__(
        self,
        bus: str,
        units: Iterable[int],
        database: Database,
        events: EventLog,
        *,
        control_required: bool,
        find: AccountLookup,
        rights: Rights,
    ) -> None:
        self._bus = bus
        self._units = units
        self._events = events
        self._find = find
        self._rights = rights
        self.restrictions = Restrictions(database, bus)
        self.control = Control(required=control_required)
        self._lifted: dict[int, tuple[CommandBlock, UnixTime]] = {}
        """The block that was lifted last of each unit, and when."""
        self._block_subscribers: list[Callable[[int], None]] = []
        self._control_subscribers: list[Callable[[], None]] = []
        self._read_only_ends: asyncio.TimerHandle | None = None
        self._requests: defaultdict[str, Bucket] = defaultdict(
            lambda: Bucket(1 / REQUEST_EVERY_S, MAX_REQUESTS)
        )
        """The requests for control, by account."""
        rights.on_withdrawn(self.revoke_control)

    async def load(self) -> None:
        """Read the restrictions from the database."""
        await self.restrictions.load(unix_now(), monotonic_now())
        self._publish_read_only()

    def on_block(self, subscriber: Callable[[int], None]) -> None:
        """Call ``subscriber`` when a unit was blocked or freed."""
        self._block_subscribers.append(subscriber)

    def on_control(self, subscriber: Callable[[], None]) -> None:
        """Call ``subscriber`` when control has another holder, or was requested."""
        self._control_subscribers.append(subscriber)

    def limits(self, unit: int) -> Limits:
        """Return the limits of a unit."""
        return self.restrictions.limits(unit)

    def block_of(self, unit: int) -> CommandBlock | None:
        """Return the block of a unit, or None."""
        return self.restrictions.block(unit)

    def lifted(self, unit: int) -> CommandBlock | None:
        """Return the block of a unit that was lifted within the last minute and not set again."""
        block, at = self._lifted.get(unit, (None, UnixTime(0.0)))
        return block if unix_now() - at < LIFTED_SHOWN_S and self.block_of(unit) is None else None

    def read_only(self) -> ReadOnly | None:
        """Return the read-only mode of the bus, with its reason and who set it; None if commands are
        accepted."""
        return self.restrictions.read_only(monotonic_now())

    def block_reason(self, unit: int, *, slows: bool = False) -> Message | None:
        """Return why a unit or its bus takes no command, and who set that; None if it does. ``slows``:
        whether the command can only make the unit slower, so that a read-only bus takes it."""
        block = (None if slows else self.read_only()) or self.block_of(unit)
        return None if block is None else Message.of("block_by", reason=block.reason, who=block.set_by)

    async def set_limits(self, person: Person, unit: int, limits: Limits) -> None:
        """Replace the limits of a unit. Raise Problem 403."""
        SET_LIMITS.check(person)
        before = self.limits(unit)
        await self.restrictions.put_limits(unit, limits, person.name, unix_now())
        await self._record(SET_LIMITS, person, before.message, limits.message, unit)

    async def block(self, person: Person, unit: int, reason: str) -> None:
        """Refuse every write to a unit from now on. Raise Problem 403."""
        BLOCK.check(person)
        before = self.block_of(unit)
        await self.restrictions.put_block(unit, CommandBlock(reason, person.name, unix_now()))
        self._publish_block(unit)
        await self._record(BLOCK, person, before.reason if before else None, reason, unit)

    async def lift(self, person: Person, unit: int) -> None:
        """Lift the block of a unit, if it has one. Raise Problem 403."""
        UNBLOCK.check(person)
        before = self.block_of(unit)
        if before is None:
            return
        await self.restrictions.lift_block(unit)
        self._lifted[unit] = before, unix_now()
        self._publish_block(unit)
        await self._record(UNBLOCK, person, before.reason, None, unit)

    async def set_read_only(self, person: Person, reason: str, minutes: int | None) -> None:
        """Refuse every write that could do more than slow a unit, for ``minutes``, or until it is ended.
        Raise Problem 403."""
        SET_READ_ONLY.check(person)
        before, now = self.read_only(), unix_now()
        until = None if minutes is None else now + 60 * minutes
        await self.restrictions.put_read_only(ReadOnly(reason, person.name, now, until), monotonic_now())
        self._publish_read_only()
        new = Message.of("read_only_for", reason=reason, n=minutes) if minutes is not None else reason
        await self._record(SET_READ_ONLY, person, before.reason if before else None, new)

    async def end_read_only(self, person: Person) -> None:
        """Accept commands again. Do nothing on a bus that is not read-only. Raise Problem 403."""
        END_READ_ONLY.check(person)
        before = self.read_only()
        if before is None:
            return
        await self.restrictions.end_read_only()
        self._publish_read_only()
        await self._record(END_READ_ONLY, person, before.reason, None)

    def holding(self) -> Holding | None:
        """Return who holds control; None if it is free."""
        return self.control.holding(monotonic_now())

    def objection(self, account: str) -> Message | None:
        """Return why ``account`` may not write now, because another has control; None if it may."""
        return self.control.objection(account, monotonic_now())

    def use_control(self, account: str) -> Message | None:
        """Renew control for a write. Return why the account may not write, as :meth:`objection` does."""
        return self.control.use(account, monotonic_now())

    def holder(self) -> str:
        """Return the account of the holder; empty if control is free."""
        holding = self.holding()
        return "" if holding is None else holding.holder

    def bus_control(self) -> BusControl:
        """Return control of the bus as every page shows it, with the wall clock as it is now."""
        now, holding = monotonic_now(), self.holding()
        if holding is None:
            return BusControl(self._bus)
        request = self.control.request_now(now)
        shown = BusControl(self._bus, holding.holder, holding.since, unix_now() + holding.left_s(now))
        if request is None:
            return shown
        until = unix_now() + request.left_s(now)
        return replace(shown, requester=request.by, request=request.state(now), request_until=until)

    async def _refuse_without_right(self, act: Act, person: Person) -> None:
        """Raise Problem 403 for an account without the role of an act, or which has lost a right
        meanwhile."""
        act.check(person)
        await self._rights.check(person)

    async def take(self, person: Person) -> None:
        """Take control, if it is free. Raise Problem 403 and 409."""
        await self._refuse_without_right(TAKE_CONTROL, person)
        before = self.holding()
        self.control.take(person.account, monotonic_now(), unix_now())
        if before is None:
            await self._control_changed(TAKE_CONTROL, person, None, person.account)

    async def request(self, person: Person) -> None:
        """Request control from its holder, on every page that the holder has open. Raise Problem 403, 409,
        and 429 after too many requests of this account."""
        await self._refuse_without_right(REQUEST_CONTROL, person)
        now, bucket = monotonic_now(), self._requests[person.account]
        if not bucket.has_room(now):
            seconds = math.ceil(bucket.wait_s(now))
            problem = Problem(429, "too_many", Message.of("control_requests_too_many", n=seconds))
            problem.headers.update(self.request_limit(person).headers)
            raise problem.with_headers(Retry_After=str(seconds))
        if self.control.request(person.account, now):
            bucket.take(now)
            await self._control_changed(REQUEST_CONTROL, person, self.holder(), person.account)

    def request_limit(self, person: Person) -> RateLimit:
        """Return the number of requests for control of this bus that a person may still make now."""
        return RateLimit.of_bucket(self._requests[person.account], monotonic_now())

    async def grant(self, person: Person, shown: str | None = None) -> None:
        """Hand control over to the account that has requested it. ``shown``: whose request the person saw;
        None: whichever is open. Raise Problem 403, 409, and 422 if that account may no longer command the
        bus."""
        await self._refuse_without_right(GRANT_CONTROL, person)
        to = self.control.requester(person.account, monotonic_now())
        self._refuse_other_request(shown)
        if await self._who_may_hold(person, to) != to:
            raise Problem(422, "invalid", Message.of("holder_cannot_sign_in", name=to))
        if self.control.requester(person.account, monotonic_now()) != to:
            raise controlled(Message("control_not_requested"))
        self.control.hand_over(person.account, to, monotonic_now(), unix_now())
        await self._control_changed(GRANT_CONTROL, person, person.account, to)

    async def end_request(self, person: Person, shown: str | None = None) -> None:
        """Decline the open request as the holder, or withdraw it as its account; ``shown`` as in
        :meth:`grant`. Raise Problem 403, 409."""
        await self._refuse_without_right(END_CONTROL_REQUEST, person)
        self._refuse_other_request(shown)
        request = self.control.end_request(person.account, monotonic_now())
        withdrawn = request.by == person.account
        result = Message("control_withdrawn" if withdrawn else "control_declined")
        await self._control_changed(END_CONTROL_REQUEST, person, request.by, result)

    def _refuse_other_request(self, shown: str | None) -> None:
        request = self.control.request_now(monotonic_now())
        if shown is not None and request is not None and request.by != shown:
            raise controlled(Message("control_not_requested"))

    async def hand_over(self, person: Person, to: str) -> None:
        """Hand control over; an admin may do so without holding it. Raise Problem 403, 409, and 422 for a
        name without an account that could use it, since that would block the line until control lapses."""
        HAND_OVER_CONTROL.check(person)
        to = await self._who_may_hold(person, to)
        before = self.holding()
        by_force = person.role.includes(FORCE_CONTROL.role)
        self.control.hand_over(person.account, to, monotonic_now(), unix_now(), by_force=by_force)
        await self._control_changed(HAND_OVER_CONTROL, person, before.holder if before else None, to)

    async def _who_may_hold(self, person: Person, to: str) -> str:
        found = (to, person.role) if to == person.account else await self._find(to)
        if found is None:
            raise Problem(422, "invalid", Message.of("holder_cannot_sign_in", name=to))
        account, role = found
        if not role.includes(TAKE_CONTROL.role):
            raise Problem(422, "invalid", Message.of("holder_may_not_command", name=to, role=term(role)))
        return account

    async def release(self, person: Person) -> None:
        """Release control. Raise Problem 403 and 409."""
        RELEASE_CONTROL.check(person)
        self.control.release(person.account, monotonic_now())
        await self._control_changed(RELEASE_CONTROL, person, person.account, None)

    async def revoke_control(self, account: str) -> None:
        """Free control that the account holds, because it is signed in nowhere any more, or may do less."""
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
        """Publish every unit's block as it is now, and again when the duration of the mode is over."""
        if self._read_only_ends is not None:
            self._read_only_ends.cancel()
        left_s = self.restrictions.read_only_left_s(monotonic_now())
        if 0 < left_s < math.inf:
            loop = asyncio.get_running_loop()
            self._read_only_ends = loop.call_later(left_s, self._publish_read_only)
        for unit in self._units:
            self._publish_block(unit)

    def _publish_control(self) -> None:
        for subscriber in self._control_subscribers:
            subscriber()

    async def _control_changed(
        self, act: Act, person: Person, old: str | None, new: str | Message | None
    ) -> None:
        """Publish and record what a person has done with control."""
        self._publish_control()
        await self._record(act, person, old, new)

    async def _record(
        self,
        act: Act,
        person: Person,
        old: str | Message | None,
        new: str | Message | None,
        unit: int | None = None,
    ) -> None:
        await self._events.record(**act.by(person), bus=self._bus, unit=unit, old=old, new=new)
