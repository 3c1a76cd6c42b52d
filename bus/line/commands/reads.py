"""Requested reads, one after the other. Pure procedures (``bus.line.commands.procedure``)."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue
from bus.errors import unit_error
from bus.line.commands.procedure import CommandContext, Procedure, ProcedureResult, ReportProgress, Wait, send
from bus.line.exchange.send import Send, SendStatus
from bus.line.roster import UnitRecord, parameter_value
from bus.messages import Message, joined
from bus.wire.commands import ReadParameterRequest

MOMENT_S = 0.5
"""How long a unit that missed a request is left alone: its three tries pass in a tenth of a second."""


def read_parameters(record: UnitRecord, numbers: Sequence[int], context: CommandContext) -> Procedure:
    """Send 85h for each of ``numbers``, all of the list when empty.

    The first one without a response is read again at the end, and the rest a moment later: noise does not
    cost a complete list. A second one means that the unit stopped responding, and ends it.
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
