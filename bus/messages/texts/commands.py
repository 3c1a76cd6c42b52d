"""What is said of commands, and the values typed into them."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "setpoints_missing": "no setpoint is given: name at least one unit",
    "unit_blocked": "unit {unit} is blocked by {who}: {reason}",
    "analog_output_outside": (
        "unit {unit}: the analog output takes {lowest} (0 V, #29) to {highest} (10 V, #30); the "
        "nearest is {nearest}"
    ),
    "parameter_not_while_running": "#{number} {called} cannot be changed while the unit's run input is on",
    "setpoint_outside_protocol": (
        "unit {unit}: {value} is outside {lowest} to {highest} (what the link can carry); the "
        "nearest is {nearest}"
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
        "unit {unit}: the setpoint may move by {most} within a minute, of which {left} is left; "
        "this would move it by {step}"
    ),
    "unknown_step_needs_review": (
        "unit {unit}: a step of a size that cannot be known now needs a review, because the "
        "largest without one is {largest}; confirm it"
    ),
    "step_needs_review": (
        "unit {unit}: a step of {size} needs a review, because the largest without one is "
        "{largest}; confirm it"
    ),
    "control_held_by": "{who} holds control; ask them to hand it over",
    "control_not_taken": "nobody holds control of this line; take it first",
    "control_held": "{who} holds control of this line",
    "unit_gave_too_little": (
        "unit {unit} did not give {numbers}, without which the command cannot be judged; nothing "
        "was sent. Check its power and the cable"
    ),
    "parameter_takes": "#{number} {called} takes {values}",
    "parameter_cannot_be": "#{number} {called} cannot be {raw}: it takes {values}; the nearest is {nearest}",
    "value_range": "{lowest} to {highest}",
    "one_of_values": "{others} or {last}",
    "unit_did_not_answer": "unit {unit} did not answer",
    "no_such_output": "a unit has the auxiliary outputs 1 to 6",
    "no_such_parameter": "a unit has the parameters 1 to 40",
    "baud_unknown": "a unit speaks at {rates} baud",
    "baud_unchanged": "the line goes at {baud} baud already",
    "new_holder_unknown": "nobody of that name is here who could hold control",
    "no_bus_configured": "no bus is configured; name one in lineside.toml",
    "nothing_sent": "{reason}; nothing was sent",
    "id_used": "the id '{id}' was used for another command; nothing was sent",
    "review_lapsed": "the review has lapsed; nothing was sent",
    "limits_reversed": "the lowest setpoint is above the highest; nothing was changed",
    "decimals_unknown": "the unit's decimals (#3) are not known yet; try again when it answers",
    "protocol_maximum": "the protocol carries {most} at most; nothing was changed",
    "block_needs_reason": "say why: the next shift reads it",
    "setpoint_of_moved": "{name}: the setpoint has moved since it was reviewed; nothing was sent",
    "of_unit": "{name}: {reason}",
    "no_new_setpoint": "no new setpoint is given; empty is not zero",
    "whole_number_needed": "a whole number, please; empty is not zero",
    "output_unknown": "the state of this output is not known; nothing was sent",
    "word_not_typed": "the word was not typed; nothing was sent",
    "holder_cannot_sign_in": "there is no user {name} who may log in; control stays where it is",
    "holder_may_not_command": "{name} is {role} and may set nothing; control goes to an operator or above",
    "setpoint_moved": "the setpoint has moved since it was reviewed; nothing was sent",
    "setpoint_unknown": "the present setpoint is not known; nothing was sent",
    "step_below_zero": "the step is larger than the setpoint, which cannot go below 0; nothing was sent",
    "nothing_staged": "this unit has nothing staged; nothing was sent",
    "staged_moved": "something else is staged now; nothing was sent",
    "trace_line_malformed": "not a line of a trace ({error}): {line}",
    "unit_without_decimals": (
        "unit {unit} has no decimals (#3), so it shows no such value; give the raw number"
    ),
    "not_what_was_reviewed": "this is not what was reviewed; nothing was sent",
    "parameter_not_by_link": "#{number} {called} cannot be changed over the link",
    "not_a_number_plain": "this is not a number; write it like 1234",
    "decimals_not_read": "the unit's decimals (#3) have not been read yet; give the raw number",
    "not_a_baud_rate": "{raw} is no baud rate of the unit; it takes 300, 600, 1200, 2400, 4800 or 9600",
    "decimals_too_many": "the unit reports more decimals (#3) than a value can have; check #3 at its panel",
    "value_takes_no_decimals": "{number} has {count} decimals; this value has no",
    "value_has_decimals": "{number} has {count} decimals; this value has at most {allowed}",
    "number_missing": "no number is given, and empty is not zero; write it like {example}",
    "number_below_zero": "{number} is below 0, the lowest there is",
    "not_a_number": "'{text}' is not a number; write it like {example}",
    "analog_limits_equal": "#29 and #30 are equal, so no value stands for a voltage; set them apart first",
    "maximum_speed_zero": "#2 is 0, so a displayed speed stands for no motor speed; set #2 first",
}
