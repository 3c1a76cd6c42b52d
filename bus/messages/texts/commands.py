"""Texts about commands, the values typed into them, and their reviews."""

TEXTS = {
    "setpoints_missing": "no setpoint was given: give one for at least one unit",
    "block_by": "{reason} ({who})",
    "unit_blocked": "commands to unit {unit} are blocked by {who}: {reason}",
    "analog_output_outside": (
        "unit {unit}: the analog output accepts {lowest} (0 V, #29) to {highest} (10 V, #30); "
        "the nearest is {nearest}"
    ),
    "parameter_not_while_running": "#{number} {called} cannot be changed while the unit's run input is on",
    "setpoint_outside_protocol": (
        "unit {unit}: {value} is outside {lowest} to {highest} (protocol range); the nearest is {nearest}"
    ),
    "setpoint_outside_display": (
        "unit {unit}: {value} is outside {lowest} to {highest} (its maximum display value, #2); "
        "the nearest is {nearest}"
    ),
    "setpoint_outside_ratio": (
        "unit {unit}: {value} is outside {lowest} to {highest} (its ratio limits, #38 and #31); "
        "the nearest is {nearest}"
    ),
    "setpoint_outside_limits": (
        "unit {unit}: {value} is outside {lowest} to {highest} (the limits set for this unit); "
        "the nearest is {nearest}"
    ),
    "moves_too_far": (
        "unit {unit}: the setpoint may change by {most} within a minute, of which {left} "
        "remains; this would change it by {step}"
    ),
    "unknown_step_needs_review": (
        "unit {unit}: a step of unknown size needs a review, because the largest without a "
        "review is {largest}; confirm it"
    ),
    "step_needs_review": (
        "unit {unit}: a step of {size} needs a review, because the largest without a review is "
        "{largest}; confirm it"
    ),
    "control_held_by": "{who} has control of this line; request control",
    "control_not_taken": "control of this line is free; take control first",
    "control_held": "{who} has control of this line",
    "unit_gave_too_little": (
        "{numbers} could not be read from unit {unit}, and the command cannot be checked without "
        "them; nothing was sent. Check its power and the cable"
    ),
    "parameter_takes": "#{number} {called} takes {values}",
    "parameter_cannot_be": "#{number} {called} cannot be {raw}: it takes {values}; the nearest is {nearest}",
    "value_range": "{lowest} to {highest}",
    "one_of_values": "{others} or {last}",
    "unit_did_not_answer": "unit {unit} did not respond",
    "no_such_output": "a unit has the auxiliary outputs 1 to 6",
    "no_such_parameter": "a unit has the parameters 1 to 40",
    "baud_unknown": "a unit supports {rates} baud",
    "baud_unchanged": "the line already runs at {baud} baud",
    "new_holder_unknown": "no user of that name can take control now",
    "no_bus_configured": "no bus is configured; add one to lineside.toml",
    "nothing_sent": "{reason}; nothing was sent",
    "id_used": "the id '{id}' was used for another command; nothing was sent",
    "review_lapsed": "the review has expired; nothing was sent",
    "limits_reversed": "the lowest setpoint is above the highest; nothing was changed",
    "decimals_unknown": ("the unit's decimals (#3) are not known yet; try again when the unit responds"),
    "protocol_maximum": "the protocol maximum is {most}; nothing was changed",
    "block_needs_reason": "enter a reason; the next shift reads it",
    "setpoint_of_moved": "{name}: the setpoint has changed since the review; nothing was sent",
    "of_unit": "{name}: {reason}",
    "no_new_setpoint": "no new setpoint was entered; empty is not zero",
    "whole_number_needed": "enter a number without decimals; empty is not zero",
    "output_unknown": "the state of this output is not known; nothing was sent",
    "word_not_typed": "the word was not typed; nothing was sent",
    "holder_cannot_sign_in": "there is no user {name} who may log in; control was not changed",
    "holder_may_not_command": (
        "{name} has the role {role} and may not command units; control needs the role operator or higher"
    ),
    "setpoint_moved": "the setpoint has changed since the review; nothing was sent",
    "setpoint_unknown": "the present setpoint is not known; nothing was sent",
    "step_below_zero": "the step is larger than the setpoint, which cannot go below 0; nothing was sent",
    "nothing_staged": "this unit has nothing staged; nothing was sent",
    "staged_moved": "another setpoint is staged now; nothing was sent",
    "trace_line_malformed": "not a line of a trace ({error}): {line}",
    "unit_without_decimals": (
        "unit {unit} has no decimals (#3) and cannot show this value; give the raw number"
    ),
    "not_what_was_reviewed": "the command differs from the review; nothing was sent",
    "parameter_not_by_link": "#{number} {called} cannot be changed over the link",
    "not_a_number_plain": "this is not a number; write it like 1234",
    "decimals_not_read": "the unit's decimals (#3) have not been read yet; give the raw number",
    "not_a_baud_rate": (
        "{raw} is not a baud rate of the unit; it supports 300, 600, 1200, 2400, 4800 or 9600"
    ),
    "decimals_too_many": "the unit reports more decimals (#3) than a value can have; check #3 at its panel",
    "value_takes_no_decimals": "{number} has {count} decimals; this value has none",
    "value_has_decimals": "{number} has {count} decimals; this value has at most {allowed}",
    "number_missing": "no number was entered, and empty is not zero; write it like {example}",
    "number_below_zero": "{number} is below 0, the minimum",
    "not_a_number": "'{text}' is not a number; write it like {example}",
    "analog_limits_equal": (
        "#29 and #30 are equal, therefore no value has a voltage; set them to different values first"
    ),
    "maximum_speed_zero": "#2 is 0, therefore a displayed speed has no motor speed; set #2 first",
    # A review: why a unit cannot take a command, and what may be unexpected.
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
