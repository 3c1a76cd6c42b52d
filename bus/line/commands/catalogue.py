"""How a worker carries out each kind of command: the procedure of each, and its claim on the wire."""

from __future__ import annotations

from collections.abc import Mapping

from bus.contract import (
    ChangeBaud,
    ExecuteAll,
    ReadParameters,
    ScanBus,
    SetLine,
    UnitAction,
    UnitScale,
    WireAction,
)
from bus.contract.durations import stage_s
from bus.instants import Monotonic
from bus.line.commands import change_baud, reads, scan_bus, staging, writes
from bus.line.commands.command_run import EVERY_UNIT, NO_UNIT, CommandRun, Priority
from bus.line.commands.procedure import CommandContext, Procedure
from bus.line.line_loop import LineLoop


def command_run_of(
    line: LineLoop,
    command_id: str,
    action: WireAction,
    deadline: Monotonic,
    scales: Mapping[int, UnitScale] | None = None,
    *,
    typed: bool = False,
) -> CommandRun:
    """``action`` with its claim on the wire; its procedure is made in its turn. ``deadline``: line time.
    ``scales``, ``typed``: as in ``bus.contract.Command``."""
    scales = scales or {}
    reads = max(map(len, scales.values()), default=0) if typed else 0
    command = CommandContext(
        line.dialect,
        time_left_s=deadline - line.clock.now(),
        exchange_s=stage_s(line.baud, reads),
        scales=scales,
        typed=typed,
    )
    return CommandRun(
        command_id,
        _priority(action),
        _units_claimed(action),
        deadline,
        command,
        lambda: _procedure(line, action, command),
        lambda step: line.apply(command_id, step),
    )


def _procedure(line: LineLoop, action: WireAction, command: CommandContext) -> Procedure:
    match action:
        case ExecuteAll():
            return staging.execute_all(line.roster, command)
        case SetLine():
            return staging.set_line(line.roster, action.setpoints, command)
        case ChangeBaud():
            own_rate = "://" not in line.bus.port
            return change_baud.change_baud(line.roster, line.baud, action.baud, command, own_rate=own_rate)
        case ScanBus():
            pace = scan_bus.ScanPace(line.baud, line.bus.turnaround_s)
            return scan_bus.survey(action.first, action.last, pace, command)
        case ReadParameters():
            return reads.read_parameters(line.roster[action.unit], action.numbers, command)
        case _:
            return writes.write_to_unit(line.roster[action.unit], action, command)


def _priority(action: WireAction) -> Priority:
    match action:
        case ScanBus() | ReadParameters(urgent=False):
            return Priority.SLOW
        case ReadParameters():
            return Priority.READ
        case _:
            return Priority.WRITE


def _units_claimed(action: WireAction) -> frozenset[int]:
    """Return the units that no other command may write to meanwhile; a broadcast reaches every unit."""
    if not action.writes:
        return NO_UNIT
    return frozenset(action.units) if isinstance(action, UnitAction) else EVERY_UNIT
