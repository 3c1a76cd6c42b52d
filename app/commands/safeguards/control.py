"""Who holds control of a bus, where the site allows one user at a time. Pure: time is passed in.

Control is held in memory only: after a restart it is free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from app.errors import Problem
from app.web.access import account_shown
from bus.instants import Monotonic, UnixTime
from bus.messages import Message

LAPSES_AFTER_S = 600.0


@dataclass(frozen=True, slots=True)
class Holding:
    """Control of one bus. It lapses after :data:`LAPSES_AFTER_S` without a command of its holder, also where
    the wall clock is set meanwhile; ``since`` is for people."""

    holder: str
    since: UnixTime
    used_at: Monotonic

    def left_s(self, now: Monotonic) -> float:
        """Until control lapses, unless its holder sends another command."""
        return LAPSES_AFTER_S - (now - self.used_at)


class Control:
    """One holder at most, by account."""

    def __init__(self, *, required: bool) -> None:
        self.required = required
        self._holding: Holding | None = None

    def holding(self, now: Monotonic) -> Holding | None:
        """The holder of control; None where it is free."""
        holding = self._holding
        return holding if holding is not None and holding.left_s(now) > 0 else None

    def take(self, who: str, now: Monotonic, at: UnixTime) -> Holding:
        """Take control, if it is free; ``at`` is shown as the time of it. Raises Problem 409."""
        holding = self.holding(now)
        if holding is not None and holding.holder != who:
            raise controlled(Message.of("control_held_by", who=account_shown(holding.holder)))
        since = holding.since if holding is not None else at
        self._holding = Holding(who, since, now)
        return self._holding

    def hand_over(
        self, who: str, to: str, now: Monotonic, at: UnixTime, *, by_force: bool = False
    ) -> Holding:
        """Hand control over; ``at`` is shown as the time of it. Raises Problem 409 for a user who does not
        hold it."""
        if not by_force:
            self._require(who, now)
        self._holding = Holding(to, at, now)
        return self._holding

    def release(self, who: str, now: Monotonic) -> None:
        """Release control. Raises Problem 409 for one who does not hold it."""
        self._require(who, now)
        self._holding = None

    def revoke(self, who: str, now: Monotonic) -> bool:
        """Free what this account held, as it may hold nothing more. Returns whether it held control now."""
        if self._holding is None or self._holding.holder != who:
            return False
        held = self.holding(now) is not None
        self._holding = None
        return held

    def objection(self, who: str, now: Monotonic) -> Message | None:
        """Why this account may not write now; None where it may."""
        return self._held_by_other(who, now) if self.required else None

    def use(self, who: str, now: Monotonic) -> Message | None:
        """Renew control for a write of its holder. Returns why this account may not write, as
        :meth:`objection` does."""
        objection = self.objection(who, now)
        if self.required and objection is None and self._holding is not None:
            self._holding = replace(self._holding, used_at=now)
        return objection

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


def controlled(reason: Message) -> Problem:
    """The refusal of what needs control."""
    return Problem(409, "controlled", reason, outcome="controlled")
