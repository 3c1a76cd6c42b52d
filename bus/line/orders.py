"""Which errand an action of the contract is: its claim on the wire, the units it claims, its procedure."""

from __future__ import annotations

from collections.abc import Callable

from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ScanBus,
    SetLine,
    SetSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.contract.durations import stage_s
from bus.line import reads, rebaud, staging, survey, writes
from bus.line.errand import EVERY_UNIT, NO_UNIT, Claim, Errand
from bus.line.poller import Poller
from bus.line.roster import Roster
from bus.line.steps import Procedure, Wish


def errand_of(poller: Poller, command_id: str, action: Action, deadline: float) -> Errand | None:
    """``deadline`` on the line's clock. None for an action that is not for the wire."""
    wish = Wish(
        poller.bus.dialect,
        time_left_s=deadline - poller.clock.now(),
        exchange_s=stage_s(poller.baud),
    )
    begin = _procedure(poller, action, wish)
    if begin is None:
        return None
    claim, units = _claim(action)
    return Errand(command_id, claim, units, deadline, wish, begin, lambda step: poller.note(command_id, step))


def _claim(action: Action) -> tuple[Claim, frozenset[int]]:
    match action:
        case ReadParameters(urgent=urgent):
            return (Claim.READ if urgent else Claim.SLOW), NO_UNIT
        case ScanBus():
            return Claim.SLOW, NO_UNIT
        case SetSpeed() | ExecuteSpeed() | WriteOutput() | WriteAnalogOutput() | WriteParameter():
            return Claim.WRITE, frozenset({action.unit})
        case _:
            return Claim.WRITE, EVERY_UNIT


def _procedure(poller: Poller, action: Action, wish: Wish) -> Callable[[], Procedure] | None:
    roster = poller.roster
    match action:
        case ExecuteAll():
            return lambda: staging.execute_all(roster, wish)
        case SetLine(setpoints=setpoints):
            return lambda: staging.set_line(roster, setpoints, wish)
        case ReadParameters(unit=unit, numbers=numbers):
            return lambda: reads.read_parameters(roster[unit], numbers, wish)
        case ChangeBaud(baud=baud):
            own_rate = "://" not in poller.bus.port
            return lambda: rebaud.change_baud(roster, poller.baud, baud, wish, own_rate=own_rate)
        case ScanBus(first=first, last=last):
            pace = survey.Pace(poller.baud, poller.bus.turnaround_s)
            return lambda: survey.survey(roster, first, last, pace, wish)
        case _:
            return _write(poller.roster, action, wish)


def _write(roster: Roster, action: Action, wish: Wish) -> Callable[[], Procedure] | None:
    match action:
        case SetSpeed(unit=unit, raw=raw, execute=True):
            return lambda: writes.set_and_execute(roster[unit], raw, wish)
        case SetSpeed(unit=unit, raw=raw):
            return lambda: writes.stage(roster[unit], raw)
        case ExecuteSpeed(unit=unit):
            return lambda: writes.execute(roster[unit], wish)
        case WriteOutput(unit=unit, number=number, on=on):
            return lambda: writes.write_output(unit, number, on)
        case WriteAnalogOutput(unit=unit, raw=raw):
            return lambda: writes.write_analog_output(unit, raw)
        case WriteParameter(unit=unit, number=number, raw=raw):
            return lambda: writes.write_parameter(unit, number, raw)
        case _:
            return None
