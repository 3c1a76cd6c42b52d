"""What happens to a command, as messages of the contract."""

from __future__ import annotations

from bus.contract import FoundUnit, Progress, Result, Update
from bus.line.events import CommandFinished, CommandProgressed, LineUpdate
from bus.line.scan.found import Found
from bus.line.statistics.trace import Interpreter
from bus.settings import Dialect


def update_of(event: LineUpdate, dialect: Dialect) -> Update:
    match event:
        case CommandProgressed():
            return _progress(event)
        case CommandFinished():
            return _result(event, dialect)
    return event


def _progress(event: CommandProgressed) -> Progress:
    progress = event.progress
    return Progress(event.command_id, event.at, progress.stage, progress.unit, progress.done, progress.of)


def _result(event: CommandFinished, dialect: Dialect) -> Result:
    result, interpreter = event.result, Interpreter(dialect)
    return Result(
        event.command_id,
        event.at,
        result.outcome,
        result.message,
        unit_error=result.unit_error,
        read_back=result.read_back,
        units=list(result.units),
        values=list(result.values),
        found=[_found_unit(found) for found in result.found],
        skew_s=result.skew_s,
        frames=[interpreter.frame(passed) for passed in event.frames],
    )


def _found_unit(found: Found) -> FoundUnit:
    return FoundUnit(found.unit, found.baud, found.kind, list(found.parameters), list(found.remarks))
