"""How a worker carries out each kind of command: one row each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ScanBus,
    SetLine,
    SetSpeed,
    UnitAction,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.contract.durations import stage_s
from bus.instants import Monotonic
from bus.line.commands import change_baud, reads, scan_bus, staging, writes
from bus.line.commands.command_run import EVERY_UNIT, NO_UNIT, CommandRun, Priority
from bus.line.commands.procedure import CommandContext, Procedure
from bus.line.line_loop import LineLoop

A = TypeVar("A", bound=Action)


@dataclass(frozen=True, slots=True)
class LineCommand(Generic[A]):
    """``procedure`` carries it out and reads it back; it is made when its turn has come."""

    procedure: Callable[[LineLoop, A, CommandContext], Procedure]
    priority: Callable[[A], Priority] = lambda _: Priority.WRITE


def _set_speed(line: LineLoop, action: SetSpeed, command: CommandContext) -> Procedure:
    record = line.roster[action.unit]
    if action.execute:
        return writes.set_and_execute(record, action.raw, command)
    return writes.stage(record, action.raw)


def _execute_speed(line: LineLoop, action: ExecuteSpeed, command: CommandContext) -> Procedure:
    return writes.execute(line.roster[action.unit], command)


def _execute_all(line: LineLoop, _: ExecuteAll, command: CommandContext) -> Procedure:
    return staging.execute_all(line.roster, command)


def _set_line(line: LineLoop, action: SetLine, command: CommandContext) -> Procedure:
    return staging.set_line(line.roster, action.setpoints, command)


def _write_output(_: LineLoop, action: WriteOutput, _command: CommandContext) -> Procedure:
    return writes.write_output(action.unit, action.number, action.on)


def _write_analog_output(_: LineLoop, action: WriteAnalogOutput, _command: CommandContext) -> Procedure:
    return writes.write_analog_output(action.unit, action.raw)


def _write_parameter(_: LineLoop, action: WriteParameter, _command: CommandContext) -> Procedure:
    return writes.write_parameter(action.unit, action.number, action.raw)


def _read_parameters(line: LineLoop, action: ReadParameters, command: CommandContext) -> Procedure:
    return reads.read_parameters(line.roster[action.unit], action.numbers, command)


def _change_baud(line: LineLoop, action: ChangeBaud, command: CommandContext) -> Procedure:
    own_rate = "://" not in line.bus.port
    return change_baud.change_baud(line.roster, line.baud, action.baud, command, own_rate=own_rate)


def _scan_bus(line: LineLoop, action: ScanBus, command: CommandContext) -> Procedure:
    pace = scan_bus.ScanPace(line.baud, line.bus.turnaround_s)
    return scan_bus.survey(action.first, action.last, pace, command)


COMMANDS: dict[type[Action], LineCommand[Any]] = {
    SetSpeed: LineCommand(_set_speed),
    ExecuteSpeed: LineCommand(_execute_speed),
    ExecuteAll: LineCommand(_execute_all),
    SetLine: LineCommand(_set_line),
    WriteOutput: LineCommand(_write_output),
    WriteAnalogOutput: LineCommand(_write_analog_output),
    WriteParameter: LineCommand(_write_parameter),
    ReadParameters: LineCommand(
        _read_parameters, lambda read: Priority.READ if read.urgent else Priority.SLOW
    ),
    ChangeBaud: LineCommand(_change_baud),
    ScanBus: LineCommand(_scan_bus, lambda _: Priority.SLOW),
}


def command_run_of(line: LineLoop, command_id: str, action: Action, deadline: Monotonic) -> CommandRun | None:
    """A command with its claim on the wire and its procedure; None for an action that is not for the wire.
    ``deadline`` on the line's clock."""
    row = COMMANDS.get(type(action))
    if row is None:
        return None
    command = CommandContext(
        line.bus.dialect,
        time_left_s=deadline - line.clock.now(),
        exchange_s=stage_s(line.baud),
    )
    return CommandRun(
        command_id,
        row.priority(action),
        _units_claimed(action),
        deadline,
        command,
        lambda: row.procedure(line, action, command),
        lambda step: line.apply(command_id, step),
    )


def _units_claimed(action: Action) -> frozenset[int]:
    """Return the units that no other command may write to meanwhile; a broadcast reaches every unit."""
    if not action.writes:
        return NO_UNIT
    return frozenset(action.units) if isinstance(action, UnitAction) else EVERY_UNIT
