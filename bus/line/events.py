"""What happens on a line, in the order in which it happens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bus.contract import BusLink
from bus.line.commands.procedure import ReportProgress
from bus.line.commands.result import ProcedureResult
from bus.line.roster import UnitUpdate
from bus.line.statistics.trace import TracedFrame


@dataclass(frozen=True, slots=True)
class CommandProgressed:
    """How far a command is. ``at``: Unix time in seconds."""

    command_id: str
    at: float
    progress: ReportProgress


@dataclass(frozen=True, slots=True)
class CommandFinished:
    """What became of a command, and the frames that carried it. ``at``: Unix time in seconds."""

    command_id: str
    at: float
    result: ProcedureResult
    frames: list[TracedFrame]


LineEvent = UnitUpdate | BusLink | CommandProgressed | CommandFinished
Report = Callable[[list[LineEvent]], None]
"""Receives the events of a line while the response to its next request is under way."""
