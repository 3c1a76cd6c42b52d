"""The control of a bus, if the site allows one user at a time, and requests for it. Pure: time is passed in.

Control is held in memory only: after a restart it is free. A request changes nothing until the holder grants
it, and no request takes control from a holder who does not respond.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from app.core.web.access import account_shown
from app.errors import Problem
from bus.instants import Monotonic, UnixTime
from bus.messages import Message

LAPSES_AFTER_S = 600.0
REQUEST_LAPSES_AFTER_S = 60.0
REQUEST_RESTS_S = 60.0
"""The seconds for which the end of a request is shown, and a declined request cannot be repeated."""
RequestState = Literal["pending", "declined", "lapsed"]


@dataclass(frozen=True, slots=True)
class Holding:
    """The holding of control of one bus. It lapses after :data:`LAPSES_AFTER_S` without a command of its
    holder, even if the wall clock is set meanwhile; ``since`` is for people."""

    holder: str
    since: UnixTime
    used_at: Monotonic

    def left_s(self, now: Monotonic) -> float:
        """Return the seconds until control lapses, unless its holder sends another command."""
        return LAPSES_AFTER_S - (now - self.used_at)


@dataclass(frozen=True, slots=True)
class RequestedControl:
    """A request of an account for control, to the present holder."""

    by: str
    made_at: Monotonic
    declined_at: Monotonic | None = None

    def state(self, now: Monotonic) -> RequestState:
        """Return the state; a request lapses after :data:`REQUEST_LAPSES_AFTER_S` without a response."""
        if self.declined_at is not None:
            return "declined"
        return "pending" if now - self.made_at < REQUEST_LAPSES_AFTER_S else "lapsed"

    def left_s(self, now: Monotonic) -> float:
        """Return the seconds until a pending request lapses, or an ended one is no longer shown."""
        if self.declined_at is not None:
            return self.declined_at + REQUEST_RESTS_S - now
        left_s = self.made_at + REQUEST_LAPSES_AFTER_S - now
        return left_s if self.state(now) == "pending" else left_s + REQUEST_RESTS_S


class Control:
    """The control of one bus: at most one holder, by account, and one request to that holder."""

    def __init__(self, *, required: bool) -> None:
        self.required = required
        self._holding: Holding | None = None
        self._request: RequestedControl | None = None
        self._declined: dict[str, Monotonic] = {}
        """The time when the present holder declined the last request of each account."""

    def holding(self, now: Monotonic) -> Holding | None:
        """Return who holds control; None if it is free."""
        holding = self._holding
        return holding if holding is not None and holding.left_s(now) > 0 else None

    def request_now(self, now: Monotonic) -> RequestedControl | None:
        """Return the request to the present holder, even for a while after its end; None if there is none."""
        request = self._request
        if request is None or self.holding(now) is None or request.left_s(now) <= 0:
            return None
        return request

    def take(self, who: str, now: Monotonic, at: UnixTime) -> Holding:
        """Take control if it is free; ``at`` is shown as its beginning. Raise Problem 409."""
        holding = self.holding(now)
        if holding is not None and holding.holder != who:
            raise controlled(Message.of("control_held_by", who=account_shown(holding.holder)))
        if holding is None:
            return self._give(who, now, at)
        self._holding = replace(holding, used_at=now)
        return self._holding

    def hand_over(
        self, who: str, to: str, now: Monotonic, at: UnixTime, *, by_force: bool = False
    ) -> Holding:
        """Hand control over; ``at`` is shown as its beginning. Raise Problem 409 for a user who does not
        hold it."""
        if not by_force:
            self._require(who, now)
        return self._give(to, now, at)

    def release(self, who: str, now: Monotonic) -> None:
        """Release control. Raise Problem 409 for an account that does not hold it."""
        self._require(who, now)
        self._free()

    def revoke(self, who: str, now: Monotonic) -> bool:
        """Free control if this account holds it, and end its request. Return whether it held control."""
        if self._request is not None and self._request.by == who:
            self._request = None
        if self._holding is None or self._holding.holder != who:
            return False
        held = self.holding(now) is not None
        self._free()
        return held

    def request(self, who: str, now: Monotonic) -> bool:
        """Request control from its holder. Return whether the request is new. Raise Problem 409 if control
        is free or held by ``who``, while another request is open, and for a while after the holder has
        declined."""
        holding = self.holding(now)
        if holding is None:
            raise controlled(Message("control_not_taken"))
        if holding.holder == who:
            raise controlled(Message("control_is_yours"))
        present = self.request_now(now)
        if present is not None and present.state(now) == "pending":
            if present.by == who:
                return False
            raise controlled(Message.of("control_requested_by", who=account_shown(present.by)))
        rests_s = self._rests_s(who, now)
        if rests_s > 0:
            seconds, holder = max(1, round(rests_s)), account_shown(holding.holder)
            raise controlled(Message.of("control_request_rests", who=holder, n=seconds))
        self._request = RequestedControl(who, now)
        return True

    def requester(self, who: str, now: Monotonic) -> str:
        """Return the account whose pending request ``who``, the holder, may grant. Raise Problem 409."""
        self._require(who, now)
        return self._pending(now).by

    def end_request(self, who: str, now: Monotonic) -> RequestedControl:
        """End the pending request: its account withdraws it, the holder declines it. Return the ended
        request. Raise Problem 409 for anyone else, and if there is none."""
        request, holding = self._pending(now), self.holding(now)
        if request.by == who:
            self._request = None
        elif holding is not None and holding.holder == who:
            self._request = replace(request, declined_at=now)
            self._declined[request.by] = now
        else:
            raise controlled(Message.of("control_requested_by", who=account_shown(request.by)))
        return request

    def objection(self, who: str, now: Monotonic) -> Message | None:
        """Return why this account may not write now; None if it may."""
        return self._held_by_other(who, now) if self.required else None

    def use(self, who: str, now: Monotonic) -> Message | None:
        """Renew control for a write of its holder. Return why this account may not write, as
        :meth:`objection` does."""
        objection = self.objection(who, now)
        if self.required and objection is None and self._holding is not None:
            self._holding = replace(self._holding, used_at=now)
        return objection

    def _give(self, who: str, now: Monotonic, at: UnixTime) -> Holding:
        self._free()
        self._holding = Holding(who, at, now)
        return self._holding

    def _free(self) -> None:
        self._holding = self._request = None
        self._declined.clear()

    def _rests_s(self, who: str, now: Monotonic) -> float:
        """Return the seconds for which an account whose request was declined may not make another."""
        declined_at = self._declined.get(who)
        return 0.0 if declined_at is None else declined_at + REQUEST_RESTS_S - now

    def _pending(self, now: Monotonic) -> RequestedControl:
        request = self.request_now(now)
        if request is None or request.state(now) != "pending":
            raise controlled(Message("control_not_requested"))
        return request

    def _require(self, who: str, now: Monotonic) -> None:
        objection = self._held_by_other(who, now)
        if objection is not None:
            raise controlled(objection)

    def _held_by_other(self, who: str, now: Monotonic) -> Message | None:
        holding = self.holding(now)
        if holding is None:
            return Message("control_not_taken")
        return (
            None if holding.holder == who else Message.of("control_held", who=account_shown(holding.holder))
        )


def controlled(reason: Message, bus: str = "") -> Problem:
    """Make the refusal of an act that needs control. ``bus``: that of a command, so that its page can offer
    control."""
    extra = {"bus": bus} if bus else {}
    return Problem(409, "controlled", reason, outcome="controlled", **extra)
