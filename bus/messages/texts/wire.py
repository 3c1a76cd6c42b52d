"""Texts about the wire: what a frame means, why bytes are none, a unit's errors, what a scan finds.

The wording of frames and errors follows the manual's command pages.
"""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "reply_does_not_fit": "{reply} does not fit a frame: {error}",
    "frame": "{unit}: {meaning}",
    "frame_unit": "unit {unit}",
    "frame_all_units": "all units",
    "frame_secret": "a frame with a secret value (#21), which is not stored",
    "frame_checksum_wrong": "checksum wrong, {right}h would be right; as received: {frame}",
    "frame_recorded": "{text}",
    # Requests: by name, and with what they carry.
    "request_read_status": "read speed and status",
    "request_set_speed": "set speed (staged)",
    "request_set_speed_to": "set speed (staged) {raw}",
    "request_execute_speed": "execute speed",
    "request_set_and_execute_speed": "set and execute speed",
    "request_set_and_execute_speed_to": "set and execute speed {raw}",
    "request_read_parameter": "read parameter",
    "request_read_parameter_number": "read parameter {parameter}",
    "request_write_parameter": "write parameter",
    "request_write_parameter_to": "write parameter {parameter} = {raw}",
    "request_write_output": "write auxiliary output",
    "request_write_output_on": "write auxiliary output {output} on",
    "request_write_output_off": "write auxiliary output {output} off",
    "request_write_analog_output": "write analog output",
    "request_write_analog_output_to": "write analog output {raw}",
    "parameter_not_listed": "#{number} (not in the list)",
    "value_hidden": "hidden",
    # Responses.
    "request_accepted": "accepted {request}",
    "request_accepted_with_value": "accepted {request}, and sent a value",
    "nak": "NAK, {error}",
    "nak_to_request": "NAK to {request}, {error}",
    "parameter_response": "{parameter} is {raw}",
    "ack": "ACK, write accepted",
    "ack_with_value": (
        "ACK with {raw}: the value of a parameter, or the response to a write of one; only the "
        "request shows which"
    ),
    "ack_of_wrong_length": "ACK with {count} bytes, which no response has",
    "nak_of_wrong_length": "NAK with {count} bytes, which no response has",
    "status_response": "commanded {commanded}, actual {actual}, analog {analog}; {state}",
    "status_at_speed": "at speed",
    "status_off_speed": "off speed",
    "status_remote": "remote",
    "status_not_remote": "not remote",
    "status_output": "output {output} on",
    "status_run": "run",
    "status_estop": "emergency stop active",
    "status_preset": "preset",
    "status_reverse": "reverse",
    "status_up": "up",
    "status_down": "down",
    "status_slave": "follower",
    # Not a request.
    "command_unknown": "{command}h is not a command of this length",
    "output_value_illegal": "output value {value} is not 0 or 1",
    "number_not_bcd": "{byte}h is not BCD",
    # Not a frame.
    "noise": "{count} bytes that are no frame: {reason}",
    "noise_outside": "outside a frame",
    "noise_restart": "a new frame began inside",
    "noise_escape": "10h before a byte that it cannot precede",
    "noise_too_long": "longer than any legal frame",
    "noise_too_short": "no address and command",
    "noise_checksum": "checksum",
    "noise_cut": "cut off",
    # A unit's errors: the error byte of a NAK (manual, the command pages).
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
    # What a scan finds at an address, and the likely cause of what is wrong on a bus.
    "suspect_by_address": "unit {unit} may respond in its place (#17)",
    "suspect_by_duplicates": "unit {unit} may respond in its place (each response comes twice)",
    # A scan.
    "scan_canceled": "canceled after {done} of {all} addresses",
    "scan_link_lost": "the link to the bus was lost after {done} of {all} addresses",
    "scan_echo": "the adapter receives what it sends (half duplex): its echo is recognized",
    "scan_turnaround": "units respond late: set turnaround_ms = {value} for this bus",
    "bytes_unrequested": "{count} bytes arrived in {seconds} s without a request: is another host on this"
    " line, or is the cable open? Remove the cause and scan again",
    "found_two_units": "its responses are garbled or come twice: two units at this address? Switch one off"
    " and scan again",
    "found_garbled": "every response is garbled: two units at this address, another protocol, or another baud"
    " rate",
    "found_late": "units respond later than turnaround_ms allows: increase it for this bus and scan again",
    "found_strange": "responds with valid frames, but not like a DIGIMAX IV",
    "found_refuses": ("rejects 81h with error {error}h: not a DIGIMAX IV, or another protocol (#27)"),
    "found_parameters": "has the parameters 1 to {last} only",
    "found_no_parameter": "has no parameter to read",
    "found_uncertain": "did not respond to every request; its list may be longer",
    "found_noise": Plural(
        "1 of {all} responses came with noise: check the shielding",
        "{n} of {all} responses came with noise: check the shielding",
    ),
    "found_checksum_twice": 'a checksum of 10h comes twice: set checksum_10h = "twice" for this bus',
    "found_estop_low": "turns at speed while its e-stop bit is 0: set estop_healthy = 0 for this bus",
    "found_bcd": 'numbers parameters in BCD: set parameter_numbers = "bcd" for this bus',
    "found_no_address": "does not report its own address (#17)",
    "found_other_address": (
        "#17 reads {own}, not {unit}: it numbers parameters differently, or responds for another unit"
    ),
    "found_many_addresses": "unit {unit} responds to addresses that are not its own ({count} of them)",
    "found_settings_differ": "units of this bus differ in {settings}: one [[bus]] cannot serve them all",
    # The diagnosis.
    "diagnosis_echo": "The adapter receives what it sends: switch its echo (or two-wire mode) off.",
    "diagnosis_other_protocol": (
        "Bytes arrive that are not a response: another protocol, or another baud rate?"
    ),
    "diagnosis_stray_bytes": "Bytes arrive without a request: check shielding and grounding.",
    "diagnosis_all_twice": "The responses of every unit but unit {unit} come twice: does unit {unit} respond"
    " to every address?",
    "diagnosis_other_name": (
        "The unit at address {units} reports {own} as its address (#17): does unit {own} respond "
        "for it, or does it number parameters differently?"
    ),
    "diagnosis_collisions": "Only unit {unit} responds, and something arrives when others are polled: does"
    " unit {unit} respond to every address?",
    "diagnosis_no_response": "No unit responds: check the adapter, the main cable, its termination, and the"
    " baud rate.",
    "diagnosis_one_silent": "Only unit {unit} does not respond: check its drop, its power, and its address"
    " (#17).",
    "diagnosis_silent_from": "No unit responds from unit {unit} on: check the cable between unit {before} and"
    " unit {unit}.",
    "diagnosis_some_silent": "Units {units} do not respond: check what they share, and the power of each.",
    "diagnosis_one_garbled": "Only the responses of unit {unit} are garbled: two units may have this address"
    " (#17), or its drop is bad.",
    "diagnosis_all_garbled": "Responses of every unit are garbled: check shielding, grounding and"
    " termination.",
    "diagnosis_some_garbled": (
        "Responses of units {units} are garbled: check the shielding of their section of the cable."
    ),
    "diagnosis_late": "Responses of unit {units} come late or twice: a longer turnaround_ms may be needed.",
    "diagnosis_foreign": ("Unit {units} responds with another address or length: is it a DIGIMAX IV?"),
}
