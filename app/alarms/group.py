"""What an alarm is about, for those who look for it. Pure."""

from __future__ import annotations

from typing import Literal, get_args

from app.alarms.definition import AlarmDefinition

AlarmGroup = Literal["drive", "communication", "parameters", "system", "own"]
"""``drive``: what the machine does; ``communication``: units, cable, port, worker; ``parameters``: what units
are set to; ``system``: the server; ``own``: the configuration's."""
GROUPS: tuple[AlarmGroup, ...] = get_args(AlarmGroup)
_BY_CODE: dict[str, AlarmGroup] = {
    "unit_offline": "communication",
    "link_degraded": "communication",
    "duplicate_address": "communication",
    "ratio_out_of_limits": "parameters",
    "parameter_drift": "parameters",
    "staged_left": "parameters",
    "control_left": "drive",
}
"""Where it does not follow from whether it is of a unit, a bus or the site."""


def group_of(definition: AlarmDefinition) -> AlarmGroup:
    """By its code; a built-in one without a row, by whether it is of a unit, a bus or the site."""
    if not definition.is_built_in:
        return "own"
    if definition.unit is not None:
        usual: AlarmGroup = "drive"
    else:
        usual = "system" if definition.bus is None else "communication"
    return _BY_CODE.get(definition.code, usual)
