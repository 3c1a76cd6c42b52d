"""What happens on a line, in the order in which it happens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bus.contract import BusLink
from bus.instants import UnixTime
from bus.line.commands.procedure import ProcedureResult, ReportProgress
from bus.line.roster import UnitUpdate
from bus.line.statistics.trace import TracedFrame


@dataclass(frozen=True, slots=True)
class CommandProgressed:
    """How far a command is. ``at``: Unix time in seconds."""

    command_id: str
    at: UnixTime
    progress: ReportProgress


@dataclass(frozen=True, slots=True)
class CommandFinished:
    """What became of a command, and the frames that carried it. ``at``: Unix time in seconds."""

    command_id: str
    at: UnixTime
    result: ProcedureResult
    frames: list[TracedFrame]


LineUpdate = UnitUpdate | BusLink | CommandProgressed | CommandFinished
Report = Callable[[list[LineUpdate]], None]
"""Receives the events of a line while the response to its next request is under way."""
