"""The procedure of each kind of command, and the units that it claims on the wire."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

from bus.catalogue.parameters import PARAMETERS
from bus.contract import (
    ChangeBaud,
    ExecuteAll,
    ParameterValue,
    ReadParameters,
    ScanBus,
    SetLine,
    UnitAction,
    UnitScale,
    WireAction,
)
from bus.contract.actions import stage_s
from bus.errors import unit_error
from bus.instants import Monotonic
from bus.line.commands import staging, writes
from bus.line.commands.procedure import (
    EVERY_UNIT,
    NO_UNIT,
    CommandContext,
    CommandRun,
    Priority,
    Procedure,
    ProcedureResult,
    ReportProgress,
    Wait,
    send,
)
from bus.line.commands.whole_bus import ScanPace, change_baud, survey
from bus.line.line_loop import LineLoop
from bus.line.roster import UnitRecord, parameter_value
from bus.line.send import Send, SendStatus
from bus.messages import Message, joined
from bus.wire.commands import ReadParameterRequest

MOMENT_S = 0.5
"""The seconds for which a unit that missed a request is left alone: three attempts take 0.1 s."""


def read_parameters(record: UnitRecord, numbers: Sequence[int], context: CommandContext) -> Procedure:
    """Send 85h for each of ``numbers``, or for every parameter if empty.

    The first one without a response is read again at the end, and the rest a moment later: noise does not
    cost a complete list. A second one means that the unit stopped responding, and ends the reading.
    """
    wanted = tuple(numbers) or tuple(PARAMETERS)
    waiting, missed = deque(wanted), False
    values: list[ParameterValue] = []
    refused: list[Message] = []
    while waiting:
        if context.cancelled:
            return _partly(record, values, wanted, Message("canceled"))
        number = waiting.popleft()
        yield ReportProgress("sent", record.unit, len(values), len(wanted))
        sent = yield from send(Send(ReadParameterRequest(record.unit, number), fresh=True))
        if sent.status is SendStatus.PORT_CLOSED:
            return _partly(record, values, wanted, Message("bus_link_lost"), closed=True)
        if sent.status is not SendStatus.RESPONDED:
            if missed or len(wanted) == 1:
                return _partly(record, values, wanted, Message.of("parameter_no_response", number=number))
            missed = True
            waiting.append(number)
            yield Wait(MOMENT_S)
            continue
        assert sent.responded_at is not None
        value = parameter_value(record.unit, number, sent.reply, sent.responded_at, sent.frame)
        if value is not None:
            values.append(value)
        else:
            error = unit_error(sent.refusal or 0)
            refused.append(Message.of("parameter_refused", number=number, error=error))
    if (reason := joined(refused)) is not None:
        return _partly(record, values, wanted, reason)
    return ProcedureResult("verified", values=values)


def _partly(
    record: UnitRecord,
    values: list[ParameterValue],
    wanted: Sequence[int],
    reason: Message,
    *,
    closed: bool = False,
) -> ProcedureResult:
    nothing = closed and not values
    return ProcedureResult(
        outcome="bus_closed" if nothing else "unverified",
        message=Message.of(
            "parameters_partly_read", unit=record.unit, count=len(values), all=len(wanted), reason=reason
        ),
        values=values,
    )


def command_run_of(
    line: LineLoop,
    command_id: str,
    action: WireAction,
    deadline: Monotonic,
    scales: Mapping[int, UnitScale] | None = None,
    *,
    typed: bool = False,
) -> CommandRun:
    """Return ``action`` as a command with its claim on the wire; its procedure begins when its turn comes.
    ``deadline``: on the line's clock. ``scales``, ``typed``: as in ``bus.contract.Command``."""
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
            return change_baud(line.roster, line.baud, action.baud, command, own_rate=own_rate)
        case ScanBus():
            pace = ScanPace(line.baud, line.bus.turnaround_s)
            return survey(action.first, action.last, pace, command)
        case ReadParameters():
            return read_parameters(line.roster[action.unit], action.numbers, command)
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
    """Return the units to which no other command may write meanwhile; a broadcast reaches every unit."""
    if not action.writes:
        return NO_UNIT
    return frozenset(action.units) if isinstance(action, UnitAction) else EVERY_UNIT
