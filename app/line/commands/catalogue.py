"""Every kind of command, described once. Pure.

A row holds what the app needs to know of a kind: who may send it, what it changes, how it is checked, worded
and recorded, how long it may take. The request itself is in ``bus.contract.actions``, including whether it
writes and which units it addresses; how a worker carries it out and verifies it is a row in
``bus.line.commands.catalogue``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from app.core.web.access import Role
from app.core.web.arrival import DEFAULT_TIMEOUT_S
from app.line.commands.rules import (
    NewSetpoint,
    RuleContext,
    check_analog_output,
    check_baud,
    check_line,
    check_output,
    check_parameter,
    check_setpoint,
    new_setpoints,
    objection,
    setpoint_written,
    slows_all,
    staged_setpoints,
)
from app.line.commands.values import (
    Wording,
    line_wording,
    output_wording,
    parameter_wording,
    setpoint_wording,
    staging_wording,
    wordings_by_unit,
)
from app.line.live.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS, danger_of_writing
from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.contract.actions import longest_stage_s
from bus.messages import Message, term

SCALE_READS = 3
"""The number of parameters that convert and bound a setpoint; the turn that stages a unit reads them."""


def timeout_s_for(bus: BusLive, staged_units: int = 0, *, typed: bool = False) -> float:
    """Return the seconds that a write may wait to be sent: a change of several units also needs the time of
    its staging. ``staged_units``: their number, 0 for one unit. ``typed``: the values were not raw."""
    reads = SCALE_READS if typed else 0
    return DEFAULT_TIMEOUT_S + staged_units * longest_stage_s(bus.baud, bus.settings.turnaround_s, reads)


def longest_change_s(bus: BusLive, units: int) -> float:
    """Return the seconds after which the result of a change of several units is known at the latest, even if
    it is withdrawn from each, or the scan has every second turn while what proves it is read."""
    return 3 * timeout_s_for(bus, units, typed=True)


A = TypeVar("A", bound=Action)

READ_S, READ_IN_GAPS_S = 30.0, 600.0
"""The seconds for forty reads at 300 baud, and for the same in a tenth of the wire."""
SCAN_S = 180.0


@dataclass(frozen=True, slots=True)
class CommandKind(Generic[A]):
    """A kind of command. Its functions take the request, and the bus as it is now."""

    request: type[A]
    role: Role
    """The lowest role that may send the command."""
    wording: Callable[[A, BusLive], Wording]
    """The words for the command in the events."""
    part_wordings: Callable[[A, BusLive], Mapping[int, Wording]] = lambda _, _bus: {}
    """The words for each unit's part in a change of several."""
    units_written: Callable[[A, BusLive], Sequence[int]] = lambda action, _: (
        action.units if action.writes else ()
    )
    """The units at which the command, or its broadcast, can change something."""
    setpoints: Callable[[A, BusLive], Iterable[NewSetpoint]] = lambda _, _bus: ()
    """The setpoints that the command would bring about, as far as they are known; each is checked."""
    check: Callable[[A, RuleContext], None] = lambda _, _now: None
    """The check of this kind alone. Raises Problem."""
    danger: Callable[[A], str] = lambda _: ""
    """The reason why the command must be confirmed; empty if it need not be."""
    timeout_s: Callable[[A, BusLive], float] = lambda _, bus: timeout_s_for(bus)
    """The seconds that the command may take if its sender gives no timeout."""
    writes_parameters: bool = False
    is_secret: Callable[[A], bool] = lambda _: False
    """Whether its frames carry a secret (#21)."""
    is_event: Callable[[A], bool] = lambda action: action.writes
    """Whether the command is recorded before it is sent."""
    only_slows: Callable[[A, BusLive], bool] = lambda _, _bus: False
    """Whether the command can only make units slower, or stop them, as they were last read."""


SET_SPEED: CommandKind[SetSpeed] = CommandKind(
    SetSpeed,
    Role.OPERATOR,
    wording=lambda action, bus: (
        setpoint_wording(Message("event_set_speed"), bus, action.unit, action.raw)
        if action.execute
        else staging_wording(bus, action.unit, action.raw)
    ),
    setpoints=lambda action, _: [NewSetpoint(action.unit, action.raw, is_staged=not action.execute)],
    only_slows=lambda action, bus: action.execute and slows_all({action.unit: action.raw}, bus),
)
EXECUTE_SPEED: CommandKind[ExecuteSpeed] = CommandKind(
    ExecuteSpeed,
    Role.OPERATOR,
    wording=lambda action, bus: setpoint_wording(
        Message("event_execute_speed"), bus, action.unit, bus.units[action.unit].staged
    ),
    setpoints=lambda action, bus: [
        each for each in new_setpoints(staged_setpoints(bus)) if each.unit == action.unit
    ],
)
EXECUTE_ALL: CommandKind[ExecuteAll] = CommandKind(
    ExecuteAll,
    Role.OPERATOR,
    wording=lambda _, bus: line_wording(Message("event_execute_all"), bus, staged_setpoints(bus)),
    part_wordings=lambda _, bus: wordings_by_unit(
        Message("event_execute_with_all"), bus, staged_setpoints(bus)
    ),
    units_written=lambda _, bus: list(staged_setpoints(bus)),
    setpoints=lambda _, bus: new_setpoints(staged_setpoints(bus)),
)
SET_LINE: CommandKind[SetLine] = CommandKind(
    SetLine,
    Role.OPERATOR,
    wording=lambda action, bus: line_wording(
        Message.of(
            "event_set_line" if any(action.setpoints.values()) else "event_zero_line", n=len(action.setpoints)
        ),
        bus,
        action.setpoints,
    ),
    part_wordings=lambda action, bus: wordings_by_unit(
        Message.of("event_set_speed_of_several", n=len(action.setpoints)), bus, action.setpoints
    ),
    units_written=lambda action, bus: sorted({*action.setpoints, *staged_setpoints(bus)}),
    setpoints=lambda action, _: new_setpoints(action.setpoints),
    check=check_line,
    # Its broadcast also executes what other units hold staged.
    only_slows=lambda action, bus: slows_all({**staged_setpoints(bus), **action.setpoints}, bus),
    timeout_s=lambda action, bus: timeout_s_for(bus, len(action.setpoints), typed=True),
)
WRITE_OUTPUT: CommandKind[WriteOutput] = CommandKind(
    WriteOutput,
    Role.OPERATOR,
    wording=output_wording,
    check=check_output,
)
WRITE_ANALOG_OUTPUT: CommandKind[WriteAnalogOutput] = CommandKind(
    WriteAnalogOutput,
    Role.ENGINEER,
    wording=lambda action, _: Wording(
        Message("event_set_analog_output"), new=str(action.raw), new_raw=action.raw
    ),
    check=check_analog_output,
)
WRITE_PARAMETER: CommandKind[WriteParameter] = CommandKind(
    WriteParameter,
    Role.ENGINEER,
    wording=parameter_wording,
    setpoints=setpoint_written,
    check=check_parameter,
    danger=lambda action: danger_of_writing(PARAMETERS[action.number], action.raw),
    writes_parameters=True,
    is_secret=lambda action: PARAMETERS[action.number].secret,
)
BAUD_DANGER = "every unit changes its baud rate; a unit that does not follow cannot be reached"
CHANGE_BAUD: CommandKind[ChangeBaud] = CommandKind(
    ChangeBaud,
    Role.ENGINEER,
    wording=lambda action, bus: Wording(Message("event_change_baud"), str(bus.baud), str(action.baud)),
    units_written=lambda _, bus: list(bus.units),
    check=check_baud,
    danger=lambda _: BAUD_DANGER,
    writes_parameters=True,
)
READ_PARAMETERS: CommandKind[ReadParameters] = CommandKind(
    ReadParameters,
    Role.VIEWER,
    wording=lambda action, _: Wording(
        Message.of("event_read_parameters", n=len(action.numbers) or len(PARAMETERS))
    ),
    timeout_s=lambda action, _: READ_S if action.urgent else READ_IN_GAPS_S,
)
SCAN_BUS: CommandKind[ScanBus] = CommandKind(
    ScanBus,
    Role.ENGINEER,
    wording=lambda action, _: Wording(Message.of("event_scan", first=action.first, last=action.last)),
    timeout_s=lambda _, _bus: SCAN_S,
    # A read of one address, which a swap sends every few seconds, is no event.
    is_event=lambda action: action.last > action.first,
)
READ_TRACE: CommandKind[ReadTrace] = CommandKind(
    ReadTrace,
    Role.ENGINEER,
    wording=lambda _, _bus: Wording(Message("event_read_trace")),
)

COMMANDS: dict[type[Action], CommandKind[Any]] = {
    kind.request: kind for kind in tuple(vars().values()) if isinstance(kind, CommandKind)
}
"""The rows above, by request."""


ROLES_BY_COMMAND: dict[str, Role] = {request.__name__: kind.role for request, kind in COMMANDS.items()}
"""The role that may send each command, for the templates, which name it by its request."""


def kind_of_command(action: Action) -> CommandKind[Any]:
    return COMMANDS[type(action)]


def check(action: Action, now: RuleContext) -> None:
    """Raise Problem for the first reason not to send ``action``."""
    kind = kind_of_command(action)
    for unit in kind.units_written(action, now.bus):
        if (block := now.block(unit)) is not None:
            raise objection("blocked", block.refusal(unit), unit=unit)
    kind.check(action, now)
    for setpoint in kind.setpoints(action, now.bus):
        check_setpoint(setpoint.unit, setpoint.raw, now, setpoint.kind)
    danger = kind.danger(action)
    if danger and not now.confirm:
        raise objection("dangerous", term(danger), unit=action.only_unit)
