"""Texts of a unit's errors: the error byte of a NAK (manual, the command pages)."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "several": "{messages}",
    "value_in_measure": "{value} {measure}",
    "unit_refused": "unit {unit} rejected the command: {error}",
    "unit_not_remote": "unit is not in REMOTE mode",
    "illegal_speed": "illegal speed value",
    "illegal_parameter_number": "illegal parameter number",
    "illegal_parameter_value": "illegal parameter value",
    "illegal_output_number": "illegal auxiliary output number",
    "illegal_output_value": "illegal auxiliary output value",
    "illegal_command": "illegal command",
    "analog_output_not_by_link": "analog output is not set for link control",
    "illegal_analog_value": "illegal analog output value",
    "error_not_in_manual": "error {code}h, which the manual does not name",
}
