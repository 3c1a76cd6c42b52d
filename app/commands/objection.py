"""A reason not to send what was asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from app.commands.blocks import Block
from app.commands.limits import Limits
from app.live.state import BusLive

Code = Literal["invalid", "dangerous", "confirm_needed", "blocked"]


class ObjectionError(Exception):
    """A command that is not sent. ``nearest``: the closest value that would do.

    ``reason``: why, and with ``params`` a template whose ``{names}`` they fill in, as in a Problem.
    """

    def __init__(
        self,
        code: Code,
        reason: str,
        *,
        params: Mapping[str, object] | None = None,
        unit: int | None = None,
        nearest: int | None = None,
    ) -> None:
        super().__init__(reason if params is None else reason.format(**params))
        self.code = code
        self.template = reason
        self.params = params
        self.unit = unit
        self.nearest = nearest


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What the rules look at. ``moved``: how far a unit's setpoint was moved within the last minute."""

    bus: BusLive
    limits: Callable[[int], Limits]
    block: Callable[[int], Block | None]
    moved: Callable[[int], int]
    confirm: bool = False
