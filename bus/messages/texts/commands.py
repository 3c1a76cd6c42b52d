"""What is said of commands, and the values typed into them."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
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
