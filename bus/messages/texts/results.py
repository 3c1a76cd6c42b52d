"""What became of a command on the wire: sent, acknowledged, read back."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    # Before anything is sent.
    "bus_closed": "there is no link to the bus: {reason}; nothing was sent",
    "bus_not_linked": "there is no link to the bus; nothing was sent",
    "bus_link_lost": "the link to the bus was lost",
    "deadline_passed": "the deadline passed before it could be sent; nothing was sent",
    "arrived_late": "the command arrived {seconds} s after its deadline; nothing was sent",
    "canceled": "canceled",
    "canceled_before_sending": "canceled before it was sent; nothing was sent",
    "units_busy": "another change of these units took until its deadline; nothing was sent",
    "too_many_commands": "too many commands are in progress at the bus worker; nothing was sent",
    "worker_stopping": "the bus worker is stopping; nothing was sent",
    "request_out_of_range": "{field} {value} cannot be sent; it must be {lowest} to {highest}",
    "field_unit_address": "unit address",
    "field_parameter_number": "parameter number",
    "field_output": "output",
    "field_value": "value",
    "frame_length_illegal": "a frame carries {lowest} to {highest} bytes, not {count}",
    # The outcome, where nothing more is known.
    "outcome_verified": "read back and equal",
    "outcome_acknowledged": "the unit acknowledged the command",
    "outcome_refused": "rejected by the unit",
    "outcome_invalid": "nothing was sent",
    "outcome_unverified": "not read back: whether the unit executed it is not known",
    "outcome_bus_closed": "no link to the bus; nothing was sent",
    "outcome_not_sent": "the wire was not free in time; nothing was sent",
    "outcome_because": "{outcome}: {reason}",
    # One unit.
    "unit_unresponsive": "unit {unit} does not respond; nothing was sent, its state is not known",
    "unit_no_response": "unit {unit} did not respond",
    "unit_no_acknowledgement": "unit {unit} did not acknowledge",
    "unit_refused_retry": "{refusal}; but an earlier try got no response and may have been executed",
    "write_unacknowledged": Plural(
        ("unit {unit} did not acknowledge (sent once): whether it executed the command is not known"),
        ("unit {unit} did not acknowledge (sent {n} times): whether it executed the command is not known"),
    ),
    "nothing_to_read_back": "acknowledged; there is nothing to read back",
    "unit_remark": "unit {unit}: {remark}",
    # The read-back.
    "verified_unacknowledged": "not acknowledged, but read back as requested",
    "readback_missing": "unit {unit} {response}, and {reason}: its state is not known",
    "readback_differs": "unit {unit} {response}, but {reason} (read {reads} times): its state is not what was"
    " requested",
    "response_acknowledged": "acknowledged",
    "response_missing": "did not acknowledge",
    "response_refused": "rejected the command ({error})",
    "readback_no_response": "it did not respond to the read-back",
    "speed_reads": "its commanded speed reads {value}",
    "speed_reads_while": "its commanded speed reads {value} (active: {inputs})",
    "speed_moved": "its commanded speed went from {before} to {value} although nothing was staged from here",
    "ratio_reads": "its ratio (#37) reads {value}",
    "ratio_unread": "it is a follower, and its ratio (#37) could not be read back",
    "parameter_reads": "it reads {value}",
    "parameter_unavailable": "it rejected the read-back",
    "secret_reads": "it reads another value, which is not shown",
    "output_reads_on": "the output reads on",
    "output_reads_off": "the output reads off",
    # Several units at once.
    "change_too_long": Plural(
        "staging 1 unit takes {seconds} s on this bus, and {allowed} s were given; nothing was sent",
        "staging {n} units takes {seconds} s on this bus, and {allowed} s were given; nothing was sent",
    ),
    "canceled_before_execute": "canceled before it was executed",
    "deadline_passed_staging": "the deadline passed before every unit had acknowledged",
    "no_unit_changed": "{reason}: no unit was changed",
    "no_unit_changed_staged_left": "{reason}: no unit was changed; may still be staged in unit {units}",
    "unit_untouched": "nothing was sent to it",
    "unit_unchanged": "nothing was staged from here, and its commanded speed is unchanged",
    "unit_may_hold": "unit {unit}: {reason}; {raw} may still be staged in it",
    "nothing_staged_here": "no unit had a speed staged from here",
    "staged_withdrawn": ("staged, then its present speed ({present}) was staged again; not executed"),
    "staged_left": (
        "{raw} may still be staged in it, and its present speed could not be staged again: stage "
        "its present speed before anything is executed on this line"
    ),
    "executed_singly": "missed the broadcast and was executed singly",
    "outsider_staged": (
        "unit {unit} is not part of the change but has {staged} staged and would execute it too; "
        "its present speed could not be staged"
    ),
    "outsider_moved": "unit {unit}, which was not part of the change: {reason}",
    # Reads.
    "parameters_partly_read": "unit {unit}: {count} of {all} parameters were read, then: {reason}",
    "parameter_no_response": "no response to #{number}",
    "parameter_refused": "#{number}: {error}",
    # The baud rate.
    "baud_of_device_server": (
        "the baud rate of a network port is set in its device server and cannot be changed from "
        "here; nothing was sent"
    ),
    "baud_not_possible": "the bus runs at {baud} baud; it can be changed to {rates}; nothing was sent",
    "baud_no_response": "unit {units} responds at neither rate",
    "baud_not_followed": "unit {units} stayed at {baud} baud while the others changed",
    "baud_readback_differs": ("unit {units} responds at {baud} baud, but its #18 reads another value"),
    "baud_not_held": "#18 of unit {units} reads another value",
    "baud_changed": 'the bus is at {baud} baud, every unit read back; set "baud = {baud}" for it in'
    " lineside.toml before the next start",
    "baud_at_power_up": (
        "every unit has stored {baud} baud and uses it from its next power-up; until then the "
        'bus stays at {present}. Switch all units off and on, and set "baud = {baud}" in '
        "lineside.toml"
    ),
    "baud_restored": "{reason}: every unit is back at {baud} baud, as before",
    "baud_not_restored": "{reason}; every other unit is back at {baud} baud. At the panel of unit {units}:"
    " set #18 to {value}, then switch it off and on",
}
