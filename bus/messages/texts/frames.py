"""What a frame on the wire means, and why bytes are none (manual, the command pages)."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

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
}
