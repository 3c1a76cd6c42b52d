"""What writing a parameter does to a machine that runs. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

from app.live.ramp_time import ACCELERATION, DECELERATION

Effect = Literal[
    "setpoint", "speed_scale", "ramp", "contact", "ratio_limit", "meaning", "analog_output", "unknown"
]

OPERATING_VALUES = frozenset({20, 37})
"""The setpoints. Operators change them every shift: they are no drift, and a restore writes one only when a
person has chosen it by itself."""

_PARAMETERS: Mapping[Effect, Collection[int]] = {
    "setpoint": OPERATING_VALUES,
    # The motor speed is the setpoint * #1 / #2, by the pulses of #5, and #4 in a follower (protocol.md, 3).
    "speed_scale": (1, 2, 4, 5),
    "ramp": (ACCELERATION, DECELERATION),
    "contact": (9, 10, 11, 13),
    "ratio_limit": (31, 38),
    "meaning": (3, 8),
    "analog_output": (28, 29, 30),
    # The manual names these and does not explain them (4.0); inputs and trim may act on the speed.
    "unknown": (14, 26, 32, 33, 34, 35, 36),
}
EFFECTS: Mapping[int, Effect] = {
    number: effect for effect, numbers in _PARAMETERS.items() for number in numbers
}
"""By number the effect on a running unit; a parameter that is not listed changes nothing at the machine."""

EFFECT_TEXTS: Mapping[Effect, str] = {
    "setpoint": "Changes the machine's speed now",
    "speed_scale": "Changes the speed of the running unit at once",
    "ramp": "Changes how fast the running unit changes its speed",
    "contact": "Changes the speed at once while the preset, up or down input is on",
    "ratio_limit": "Changes the speed of a running follower whose ratio is outside the new limits",
    "meaning": "Changes what the setpoints of the unit mean",
    "analog_output": "Changes the analog output at once, and the speed of what it drives",
    "unknown": "May change the running unit: the manual does not explain this parameter",
}
NO_RAMP = "Takes the ramp away: from then on the unit changes its speed at once"


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
