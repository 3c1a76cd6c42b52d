"""The effects that writing a parameter has on a running unit, and the warning before it. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

from bus.catalogue import parameters as numbers
from bus.messages import Message

Effect = Literal[
    "setpoint", "speed_scale", "ramp", "contact", "ratio_limit", "meaning", "analog_output", "unknown"
]

OPERATING_VALUES = frozenset({numbers.SPEED_SETPOINT, numbers.RATIO_SETPOINT})
"""The setpoints. Operators change them every shift: they do not count as drift, and a restore writes one only
if it is selected by name."""

_PARAMETERS: Mapping[Effect, Collection[int]] = {
    "setpoint": OPERATING_VALUES,
    # The motor speed is the setpoint * #1 / #2, by the pulses of #5, and #4 in a follower (protocol.md, 3).
    "speed_scale": (numbers.MAX_RPM, numbers.MAX_DISPLAY, numbers.BASE_RATIO, numbers.ENCODER_PPR),
    "ramp": (numbers.ACCELERATION, numbers.DECELERATION),
    "contact": (numbers.PRESET_SPEED, numbers.JUMP_UP, numbers.JUMP_DOWN, numbers.JUMP_MODE),
    "ratio_limit": (numbers.MAX_RATIO, numbers.MIN_RATIO),
    "meaning": (numbers.DECIMALS, numbers.FOLLOWER_MODE),
    "analog_output": (numbers.ANALOG_OUT_SOURCE, numbers.ANALOG_OUT_LOW, numbers.ANALOG_OUT_HIGH),
    # The manual names these without explaining them (4.0); inputs and trim may change the speed.
    "unknown": (
        *(numbers.FREEZE_MODE, numbers.ANALOG_IN_TRIM, numbers.INSTALLED_OPTION),
        *(numbers.PRESET_INPUT_MODE, numbers.REVERSE_INPUT_MODE),
        *(numbers.UP_INPUT_MODE, numbers.DOWN_INPUT_MODE),
    ),
}
EFFECTS: Mapping[int, Effect] = {
    number: effect for effect, affecting in _PARAMETERS.items() for number in affecting
}
"""The effect on a running unit by number; a parameter that is not listed has none."""

NO_RAMP = Message("effect_no_ramp")


def effect_message(effect: Effect) -> Message:
    """Return the words for an effect."""
    return Message(f"effect_{effect}")


def warning_of(number: int, raw: int, *, running: bool | None) -> Message | None:
    """Return the warning that a person must see before ``raw`` is written; None if it has no effect.

    ``running``: whether the drive may move its motor; None (not known) counts as running.
    """
    effect = EFFECTS.get(number)
    if effect == "ramp" and raw == 0:
        return NO_RAMP
    if effect is None or (running is False and effect != "setpoint"):
        return None
    return effect_message(effect)
