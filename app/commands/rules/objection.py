"""A reason not to send a command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from app.commands.safeguards.limits import CommandBlock, Limits
from app.live.state.bus_live import BusLive
from bus.errors import LinesideError
from bus.messages import Message

Code = Literal["invalid", "dangerous", "confirm_needed", "blocked"]


class ObjectionError(LinesideError):
    """A command that is not sent. The message is the reason; ``nearest`` the closest value that would do."""

    def __init__(
        self,
        code: Code,
        reason: Message,
        *,
        unit: int | None = None,
        nearest: int | None = None,
    ) -> None:
        super().__init__(reason)
        self.code = code
        self.unit = unit
        self.nearest = nearest


@dataclass(frozen=True, slots=True)
class RuleContext:
    """What the rules look at. ``moved``: how far a unit's setpoint was moved within the last minute."""

    bus: BusLive
    limits: Callable[[int], Limits]
    block: Callable[[int], CommandBlock | None]
    moved: Callable[[int], int]
    confirm: bool = False
