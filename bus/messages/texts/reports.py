"""What a command of the command line reports of its work."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "command_failed": "lineside: {reason}",
    "configuration_written": (
        "{file} is written. Set the port and the units, then: lineside check --config {file}"
    ),
    "key_rotated": "{file}: the log is sealed with a newer key; back this file up",
    "token_file_shared": "other users of this machine can read {file}; protect it: chmod 600 {file}",
    "token_expires": "expires {day}",
    "user_is_panel": "panel",
    "user_is_disabled": "disabled",
    # Stores.
    "stores_backed_up": "{file}: {names}",
    "stores_restored": "{folder}: {names} restored; what was there ends in {suffix}",
    "stores_replace": "Replace the stores in {folder} by those of {file}?",
    # The dashboard and its buses.
    "dashboard_serves": "{site}: serving at {url}",
    "dashboard_at": "Lineside: {url}",
    "bus_open": "  bus {bus}: {online} of {units} units online, port {link}",
    "bus_not_open": "  bus {bus}: {online} of {units} units online, port {link}: {cause}",
    # Backup, diff, restore.
    "unit_not_read": "unit {unit} was not read: {reason}",
    "units_not_read": "not read: unit {units}",
    "units_backed_up": Plural("{n} unit written to {file}", "{n} units written to {file}"),
    "sides_equal": "equal",
    "rows_differ": Plural("{n} row differs (file, then now):", "{n} rows differ (file, then now):"),
    "rows_to_write": Plural("{n} row to write, {equal} equal", "{n} rows to write, {equal} equal"),
    "restore_note": "note: {remark}",
    "row_left_out": "left out: {reason}",
    "row_left_out_differs": "left out: {present} → {wanted}  {reason}",
    "write_rows": "Write these rows to unit {unit}?",
    "nothing_written": "nothing was written",
    "rows_verified": Plural(
        "{verified} of {n} row verified; complete read-back: {state}",
        "{verified} of {n} rows verified; complete read-back: {state}",
    ),
    "unit_not_equal": "unit {unit} does not equal {file}: {reason}",
    "rows_still_differ": Plural(
        "{rows} differs; run it again to finish the rest", "{rows} differ; run it again to finish the rest"
    ),
    "see_rows": "see the rows",
    # Decode, scan, simulate.
    "no_valid_frame": "no valid frame in these bytes; a frame is 10 02 … 10 03 checksum.",
    "scan_begins": "Scanning {port}, {which}, at {how_long}; each unit found adds up to 2 s. Ctrl-C ends it.",
    "scan_address": "address {first}",
    "scan_addresses": "addresses {first} to {last}",
    "scan_one_baud": "{baud} baud: about {time}",
    "scan_all_bauds": "all six baud rates: about {time}",
    "scan_slower_bauds": (
        "{baud} baud, about {time}, then the slower ones until a unit responds: {most} at most"
    ),
    "duration_minutes": "{minutes} min {seconds} s",
    "duration_seconds": "{seconds} s",
    "scan_port_lost": "the port was lost: the scan is not complete, this is what was found so far.",
    "scan_interrupted": "interrupted: the scan is not complete, this is what was found so far.",
    "scan_no_response": (
        "no unit responded at {bauds} baud; look at the wiring, at #17 and #18 of the units, or allow them "
        "longer with --turnaround-ms."
    ),
    "unit_found": "unit {unit} at {baud} baud: {traits}",
    "found_digimax": "DIGIMAX IV",
    "found_kind_garbled": "garbled",
    "found_kind_foreign": "no DIGIMAX IV",
    "found_parameters_to": "parameters 1 to {last}",
    "found_remote": "remote",
    "found_not_remote": "not remote: it refuses every write",
    "found_responds_within": "responds within {time} ms",
    "option_none_of": "{value} is none of {known}",
    "option_port_refused": "{port}: {reason}",
    "option_first_above_last": "{first} is above --last {last}",
    "option_link_with_tcp": "a link leads to a pseudo-terminal, not to a TCP port",
    "simulator_port_refused": ("TCP port {port} cannot be opened: {error}; choose another, or 0 for any."),
    "simulator_link_refused": (
        "the link {link} cannot be made: {error}; name a path in a folder that is there."
    ),
    "worker_token_missing": "no token: set {variable} (see 'lineside token create')",
    "choose_port": "choose another",
    "choose_port_demo": "choose another port: lineside demo --port 8100, or make demo PORT=8100",
    "choose_port_configured": "set port in [server] of {file}",
}
