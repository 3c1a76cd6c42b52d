"""Who holds control of a line, where the site wants one person at a time. Pure: the time is passed in.

Control is held in memory only: a restarted server has given it to nobody.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from bus.errors import LinesideError
from bus.messages import Message

LAPSES_AFTER_S = 600.0


@dataclass(frozen=True, slots=True)
class Holding:
    """Control of one bus. It lapses when nothing was asked for :data:`LAPSES_AFTER_S`."""

    holder: str
    since: float
    used_at: float

    @property
    def lapses_at(self) -> float:
        """When control ends unless the holder asks for something."""
        return self.used_at + LAPSES_AFTER_S


class ControlledError(LinesideError):
    """Somebody else holds control; the message says who."""


class Control:
    """One holder at most for each bus, by account."""

    def __init__(self, *, required: bool) -> None:
        self.required = required
        self._holdings: dict[str, Holding] = {}

    def holding(self, bus: str, now: float) -> Holding | None:
        """Who holds control of this bus now, if anybody."""
        holding = self._holdings.get(bus)
        return holding if holding is not None and now < holding.lapses_at else None

    def take(self, bus: str, who: str, now: float) -> Holding:
        """Take control that nobody else holds. Raises ControlledError."""
        holding = self.holding(bus, now)
        if holding is not None and holding.holder != who:
            raise ControlledError(Message.of("control_held_by", who=holding.holder))
        since = holding.since if holding is not None else now
        self._holdings[bus] = Holding(who, since, now)
        return self._holdings[bus]

    def hand_over(self, bus: str, who: str, to: str, now: float, *, by_force: bool = False) -> Holding:
        """Give control to somebody else. Raises ControlledError for one who does not hold it."""
        holding = self.holding(bus, now)
        if not by_force and (holding is None or holding.holder != who):
            raise ControlledError(_who_holds(holding))
        self._holdings[bus] = Holding(to, now, now)
        return self._holdings[bus]

    def release(self, bus: str, who: str, now: float) -> None:
        """Give control back. Raises ControlledError for one who does not hold it."""
        holding = self.holding(bus, now)
        if holding is None or holding.holder != who:
            raise ControlledError(_who_holds(holding))
        del self._holdings[bus]

    def release_all_of(self, who: str, now: float) -> list[str]:
        """Whatever somebody held is free, as they are gone. Gives the buses."""
        theirs = [bus for bus, holding in self._holdings.items() if holding.holder == who]
        held = [bus for bus in theirs if self.holding(bus, now) is not None]
        for bus in theirs:
            del self._holdings[bus]
        return held

    def objection(self, bus: str, who: str, now: float) -> Message | None:
        """Why somebody may not write now; None where they may."""
        holding = self.holding(bus, now)
        if not self.required or (holding is not None and holding.holder == who):
            return None
        return _who_holds(holding)

    def use(self, bus: str, who: str, now: float) -> None:
        """A write is about to be asked: it needs control, and keeps it. Raises ControlledError."""
        objection = self.objection(bus, who, now)
        if objection:
            raise ControlledError(objection)
        holding = self.holding(bus, now)
        if self.required and holding is not None:
            self._holdings[bus] = replace(holding, used_at=now)


def _who_holds(holding: Holding | None) -> Message:
    if holding is None:
        return Message("control_not_taken")
    return Message.of("control_held", who=holding.holder)
