"""Texts about a bus worker, its port and its links, and about a command without a result."""

TEXTS = {
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
    # A bus worker, and about a command whose result the app does not have.
    "worker_version_differs": (
        "this dashboard has version {version} of the contract and the worker {of_worker}: "
        "install the same release of lineside on both"
    ),
    "worker_token_of_other_bus": "the token is for bus {bus}; create one for the bus of this worker",
    "worker_bus_unknown": "no [[bus]] is called {bus} in this dashboard's lineside.toml (it has: {known})",
    "worker_bus_held": "another worker has this bus, or had it a moment ago",
    "updates_implausible": (
        "invalid time or a unit that is not configured; check the clock and the units of the bus worker"
    ),
    "updates_late_known": (
        "late, and of a time that the bus worker reported before or was connected; nothing stored was changed"
    ),
    "updates_over_quota": "more than the wire can carry; is another program using the token of this bus?",
    "event_worker_started": "bus worker started, port {port}",
    "event_worker_back": "bus worker is back, port {port}",
    "event_worker_refused": "bus worker refused",
    "event_updates_refused": "updates of the bus worker refused",
    "event_worker_clock_stepped": "clock of the bus worker stepped by {step} s",
    "worker_not_connected": "the bus worker is not connected",
    "worker_silent": "the bus worker is connected and does not respond",
    "worker_malformed": "the bus worker was disconnected: it sent a malformed message",
    "worker_lost": "the bus worker is not connected: whether the unit executed it is not known",
    "worker_restarted": "the bus worker was restarted: whether the unit executed it is not known",
    "worker_no_response": ("the bus worker does not respond: whether the unit executed it is not known"),
    "worker_no_result": ("the bus worker did not report a result: whether the unit executed it is not known"),
    "server_stopped": "the server stopped before the result was known",
    "result_unreadable": (
        "its result was stored and cannot be read: whether the unit executed it is not known"
    ),
    "secret_differs": "the unit reads another value, which is not shown",
}
