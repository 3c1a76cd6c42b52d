"""Who holds control of a bus, where the site allows one user at a time. Pure: time is passed in.

Control is held in memory only: after a restart it is free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from app.web.access import account_shown
from bus.errors import LinesideError
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


class ControlledError(LinesideError):
    """Another user holds control; the message names the holder."""


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
        """Take control, if it is free; ``at`` is shown as the time of it. Raises ControlledError."""
        holding = self.holding(now)
        if holding is not None and holding.holder != who:
            raise ControlledError(Message.of("control_held_by", who=account_shown(holding.holder)))
        since = holding.since if holding is not None else at
        self._holding = Holding(who, since, now)
        return self._holding

    def hand_over(
        self, who: str, to: str, now: Monotonic, at: UnixTime, *, by_force: bool = False
    ) -> Holding:
        """Hand control over; ``at`` is shown as the time of it. Raises ControlledError for a user who does
        not hold it."""
        holding = self.holding(now)
        if not by_force and (holding is None or holding.holder != who):
            raise ControlledError(_who_holds(holding))
        self._holding = Holding(to, at, now)
        return self._holding

    def release(self, who: str, now: Monotonic) -> None:
        """Release control. Raises ControlledError for one who does not hold it."""
        holding = self.holding(now)
        if holding is None or holding.holder != who:
            raise ControlledError(_who_holds(holding))
        self._holding = None

    def revoke(self, who: str, now: Monotonic) -> bool:
        """Free what this account held, as it may hold nothing more. Returns whether it held control now."""
        if self._holding is None or self._holding.holder != who:
            return False
        held = self.holding(now) is not None
        self._holding = None
        return held

    def objection(self, who: str, now: Monotonic) -> Message | None:
        """Why ``account`` may not write now; None where it may."""
        holding = self.holding(now)
        if not self.required or (holding is not None and holding.holder == who):
            return None
        return _who_holds(holding)

    def use(self, who: str, now: Monotonic) -> None:
        """Require control for a write, and renew it. Raises ControlledError."""
        objection = self.objection(who, now)
        if objection:
            raise ControlledError(objection)
        holding = self.holding(now)
        if self.required and holding is not None:
            self._holding = replace(holding, used_at=now)


def _who_holds(holding: Holding | None) -> Message:
    if holding is None:
        return Message("control_not_taken")
    return Message.of("control_held", who=account_shown(holding.holder))
