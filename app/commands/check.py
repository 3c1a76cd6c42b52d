"""Whether a command may be sent: every check that can be made before a byte reaches the wire. Pure."""

from __future__ import annotations

from app.commands.catalogue import kind_of_command
from app.commands.rules.objection import RuleContext, objection
from app.commands.rules.setpoint import check_setpoint
from bus.contract import Action
from bus.messages import term


def check(action: Action, now: RuleContext) -> None:
    """Raises Problem for the first reason not to send ``action``."""
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
