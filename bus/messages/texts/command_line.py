"""Texts of the command line: options, files, the dashboard, and what a command reports of its work."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "token_not_given": (
        "there is no token: give --token-file FILE, set {variable} or give --token TOKEN; 'lineside token"
        " create' makes one"
    ),
    "token_given_twice": "--token and --token-file are both given; give one of them",
    "token_malformed": "the token has a character that no token has; copy it again",
    "token_file_unreadable": "the token file {file} cannot be read: {error}",
    "token_file_empty": "the token file {file} has no token in its first line",
    "dashboard_lacks_bus": "there is no bus '{bus}'; this dashboard has {known}",
    "dashboard_lacks_unit": "bus '{bus}' has no unit {unit}; it has {known}",
    "dashboard_unreachable": "{url} cannot be reached: {error}; {advice}",
    "dashboard_url_malformed": "--url '{url}' is no address; give for example http://127.0.0.1:8000",
    "authorities_unusable": "{variable} '{value}' cannot be used: {reason}",
    "is_dashboard_running": "is the dashboard running?",
    "name_authority": "name the certificate of its authority in SSL_CERT_FILE",
    "no_certificate": "it holds no certificate",
    "dashboard_refused": "{detail}",
    "dashboard_failed": "{method} {path} ended with status {status}",
    "bytes_missing": "no bytes given; write them as hex, for example 10 02 04 81 10 03 7B",
    "bytes_malformed": "'{text}' is not hex in pairs of digits, like 10 02 04 81 10 03 7B",
    "bytes_and_file": "give bytes or --file, not both",
    "folder_missing": "there is no folder {folder} for {file}; nothing was read",
    "file_not_regular": "{file} is not a regular file; name another file; nothing was read",
    "file_unreadable": "{file} cannot be read: {error}",
    "file_lacks_unit": "{file} holds units {held}, not {unit}; back that unit up, or name one of these",
    "diff_sides_missing": "give two files, or one file with --url, --token-file, --bus and --unit",
    "files_differ_in_units": "the files do not hold the same units: {units} is in one of them only",
    "data_in_use": "another Lineside server uses {folder}; end it, or give this one its own",
    "data_not_writable": (
        "nothing can be written to {folder}: {error}; give the server's user write access to it, or name "
        "another folder as data in [server]"
    ),
    "part_not_started": "the dashboard could not start: {part}: {reason}",
    "dashboard_not_started": "the dashboard could not start; see the messages above",
    "simulator_not_started": "the simulated line could not start; see the messages above",
    "not_serving": (
        "no dashboard responds at {url}. Start it with lineside serve --config {config}, or read "
        "the log of its service."
    ),
    "app_url_malformed": "--app '{url}' is no address; give for example http://192.168.1.10:8000",
    "listen_no_host": (
        "there is no host '{host}'. Set host in [server] to an address of this machine, or 0.0.0.0."
    ),
    "listen_port_in_use": (
        "port {port} of {host} is in use by another program. End that program, or {choose}."
    ),
    "listen_port_reserved": "port {port} of {host} is reserved for root. Take a port above 1023: {choose}.",
    "listen_foreign_address": (
        "{host} is no address of this machine. Set host in [server] to one that is, or to 0.0.0.0."
    ),
    "listen_failed": "port {port} of {host} cannot be opened: {error}. Check host and port in [server].",
    # What a command of the command line reports of its work.
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
    "site_degraded": "  degraded: {fault}",
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
