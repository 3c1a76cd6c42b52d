"""Texts of a review: why a unit cannot take a command, and what may be unexpected."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "obstacle_blocked": "commands blocked: {block}",
    "obstacle_no_link": "no link to the bus",
    "obstacle_offline": "does not respond",
    "obstacle_not_in_remote": "not in REMOTE",
    "risk_above_display": "above its maximum display value (#2): the unit may reject it",
    "risk_stale": "its last response is {age} s old",
    "risk_estop_active": "the emergency stop is active: the setpoint takes effect when it clears",
    "risk_run_off": "run input is off: the setpoint takes effect when it is on",
    "risk_no_ramp": "changes immediately, without a ramp: #{number} is 0.0 s",
    "risk_ramp_unknown": "duration of its ramp unknown",
    "risk_is_setpoint": "this is a setpoint: the machine may change its speed immediately",
}
