"""What writing a parameter does to a machine that runs. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

from bus.catalogue import numbers

Effect = Literal[
    "setpoint", "speed_scale", "ramp", "contact", "ratio_limit", "meaning", "analog_output", "unknown"
]

OPERATING_VALUES = frozenset({numbers.SPEED_SETPOINT, numbers.RATIO_SETPOINT})
"""The setpoints. Operators change them every shift: they are no drift, and a restore writes one only when a
person has chosen it by itself."""

_PARAMETERS: Mapping[Effect, Collection[int]] = {
    "setpoint": OPERATING_VALUES,
    # The motor speed is the setpoint * #1 / #2, by the pulses of #5, and #4 in a follower (protocol.md, 3).
    "speed_scale": (numbers.MAX_RPM, numbers.MAX_DISPLAY, numbers.BASE_RATIO, numbers.ENCODER_PPR),
    "ramp": (numbers.ACCELERATION, numbers.DECELERATION),
    "contact": (numbers.PRESET_SPEED, numbers.JUMP_UP, numbers.JUMP_DOWN, numbers.JUMP_MODE),
    "ratio_limit": (numbers.MAX_RATIO, numbers.MIN_RATIO),
    "meaning": (numbers.DECIMALS, numbers.FOLLOWER_MODE),
    "analog_output": (numbers.ANALOG_OUT_SOURCE, numbers.ANALOG_OUT_LOW, numbers.ANALOG_OUT_HIGH),
    # The manual names these and does not explain them (4.0); inputs and trim may act on the speed.
    "unknown": (
        *(numbers.FREEZE_MODE, numbers.ANALOG_IN_TRIM, numbers.INSTALLED_OPTION),
        *(numbers.PRESET_INPUT_MODE, numbers.REVERSE_INPUT_MODE),
        *(numbers.UP_INPUT_MODE, numbers.DOWN_INPUT_MODE),
    ),
}
EFFECTS: Mapping[int, Effect] = {
    number: effect for effect, affecting in _PARAMETERS.items() for number in affecting
}
"""By number the effect on a running unit; a parameter that is not listed changes nothing at the machine."""

EFFECT_TEXTS: Mapping[Effect, str] = {
    "setpoint": "Changes the machine's speed now",
    "speed_scale": "Changes the speed of the running unit immediately",
    "ramp": "Changes the ramp of the running unit",
    "contact": "Changes the speed immediately while the preset, up or down input is on",
    "ratio_limit": "Changes the speed of a running follower whose ratio is outside the new limits",
    "meaning": "Changes the meaning of the unit's setpoints",
    "analog_output": ("Changes the analog output immediately, and the speed of the equipment that it drives"),
    "unknown": "May change the running unit: the manual does not explain this parameter",
}
NO_RAMP = "Removes the ramp: the unit then changes its speed immediately"


def warning_of(number: int, raw: int, *, running: bool | None) -> str:
    """What a person must know before ``raw`` is written; empty where there is nothing to fear at the machine.

    ``running``: the Run input of the unit (None: not known, taken as running).
    """
    effect = EFFECTS.get(number)
    if effect == "ramp" and raw == 0:
        return NO_RAMP
    if effect is None or (running is False and effect != "setpoint"):
        return ""
    return EFFECT_TEXTS[effect]
