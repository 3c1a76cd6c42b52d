"""Why a port cannot be opened or is lost, and how the link to a unit is."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "no_response_yet": "no response yet",
    "response_overdue": "a response is overdue",
    "responses_missed": "no response to {count} requests in a row",
    "port_not_opened": "not opened yet",
    "port_missing": "{port} does not exist: is the adapter plugged in?",
    "port_missing_others": ("{port} does not exist: is the adapter plugged in? Existing ports: {ports}"),
    "port_not_permitted": "{port} may not be opened: the user that runs lineside needs the right to read and"
    " write it",
    "port_not_permitted_group": "{port} may not be opened: add the user to its group,"
    " 'sudo usermod -aG {group} {user}', and log in again",
    "port_not_serial": "{port} is not a serial port",
    "port_in_use": "{port} is in use by another program",
    "port_in_use_by": "{port} is in use by {programs}",
    "process": "{program} (process {pid})",
    "port_not_opened_error": "{port} cannot be opened ({error})",
    "port_blocked": "{port} accepts no bytes: is its handshake line connected?",
    "port_full": "{port} accepts no bytes",
    "port_partly_sent": "{port} accepted {sent} of {all} bytes",
    "port_gone": "{port} was disconnected",
    "port_gone_error": "{port} was disconnected ({error})",
    "adapter_gone": "{port} was disconnected: was the adapter unplugged?",
    "port_lost_error": "{reason} ({error})",
    "port_baud_refused": "{port} cannot be set to {baud} baud ({error})",
    "port_own_baud": "{port} has its own baud rate; set {baud} in the device server",
    "connection_closed": "{port} closed the connection",
    "connection_refused": "{port} refuses the connection: is its port number right, or is another host"
    " connected?",
    "device_server_no_response": "{port} does not respond: is the device server on, and its address right?",
    "rfc2217_no_response": "{port} does not respond: is the device server on, in RFC 2217 mode, and its"
    " address right?",
    "rfc2217_not_installed": "{port} needs one more package: pip install 'lineside[rfc2217]'",
    "port_no_host": "{port} names no host: check the part before the port number",
    "port_no_number": "{port} needs a host and a port number, as in {example}",
    "port_unreachable": "{port} cannot be reached ({error})",
}
