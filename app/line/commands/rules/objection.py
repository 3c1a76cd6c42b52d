"""A reason not to send a command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from app.errors import Problem
from app.line.commands.safeguards.limits import CommandBlock, Limits
from app.line.live.state.bus_live import BusLive
from bus.messages import Message

Code = Literal["invalid", "dangerous", "confirm_needed", "blocked"]
_STATUS: dict[Code, int] = {"invalid": 422, "dangerous": 409, "confirm_needed": 409, "blocked": 423}


def objection(code: Code, reason: Message, *, unit: int | None = None, nearest: int | None = None) -> Problem:
    """The refusal of a command. ``nearest``: the closest value that would do."""
    offered = {} if nearest is None else {"nearest": nearest}
    message = Message.of("nothing_sent", reason=reason)
    return Problem(_STATUS[code], code, message, outcome=code, unit=unit, **offered)


def reason_of(problem: Problem) -> Message:
    """Why a command would be refused, where it is one of several: that nothing was sent is left to the one
    refusal of all."""
    reason = problem.message.params.get("reason")
    return reason if isinstance(reason, Message) else problem.message


@dataclass(frozen=True, slots=True)
class RuleContext:
    """What the rules look at. ``moved``: how far a unit's setpoint was moved within the last minute."""

    bus: BusLive
    limits: Callable[[int], Limits]
    block: Callable[[int], CommandBlock | None]
    moved: Callable[[int], int]
    confirm: bool = False
