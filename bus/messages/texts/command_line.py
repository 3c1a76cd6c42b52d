"""Texts of the command line: options, files and the dashboard."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

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
}
