"""What ``lineside check`` finds of a configuration on this machine."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "machine_user": "user {user}",
    "check_configuration": "{file}: {site}",
    "check_no_bus": (
        "there is no [[bus]], so there is nothing to show. Write one for each cable, with its name, its port "
        "and its [[bus.unit]] tables; 'lineside init --config FILE' writes a file to start from."
    ),
    "check_address": "dashboard at {host} port {port}",
    "check_address_in_use": (
        "dashboard at {host} port {port}, which is in use now: by a running Lineside, or by another program"
    ),
    "check_server_refused": "[server]: {reason}",
    "check_data": "data in {folder}",
    "check_data_later": "data in {folder}, created at the first start",
    "check_data_is_file": "data: {folder} is no folder. Name another one as data in [server].",
    "check_data_not_writable": (
        "data: {user} may not write to {folder}. Give the folder to the user that runs Lineside, name "
        "another one as data in [server], or run this check as that user."
    ),
    "check_data_not_creatable": (
        "data: {user} may not create {folder}. Give the folder to the user that runs Lineside, name another "
        "one as data in [server], or run this check as that user."
    ),
    "check_bus": Plural(
        "bus {bus}: {n} unit at {port}, {baud} baud", "bus {bus}: {n} units at {port}, {baud} baud"
    ),
    "check_bus_absent": Plural(
        "bus {bus}: {n} unit at {port}, which is not there now; Lineside waits for it, {baud} baud",
        "bus {bus}: {n} units at {port}, which is not there now; Lineside waits for it, {baud} baud",
    ),
    "check_bus_without_units": (
        "bus {bus} has no [[bus.unit]]; 'lineside scan --port {port}' lists the addresses that respond"
    ),
    "check_port_refused": "bus {bus}: {reason}.",
    "check_port_no_device": "bus {bus}: {reason}. Name a device, such as one in /dev/serial/by-id/.",
    "check_port_needs_package": "bus {bus}: {port} needs one more package: pip install 'lineside[rfc2217]'.",
    "check_port_host_unknown": (
        "bus {bus}: {port} names a host that this machine does not know. Check its spelling, or give its IP "
        "address."
    ),
    "check_key": "audit key {file}",
    "check_key_new": "audit key {file}, made at the first start",
    "check_key_new_beside_data": (
        "audit key {file}, made at the first start; who can read the data can forge the log: name a key_file "
        "in [audit]"
    ),
    "check_key_refused": "[audit]: {reason}.",
    "check_key_not_creatable": (
        "audit key: {user} may not make {file}. Give that user write access to {folder} for the first start, "
        "or name another place as key_file in [audit]."
    ),
    "check_anchor": "audit anchor {file}",
    "check_anchor_no_file": "anchor: {file} is no file. Name a file as anchor in [audit].",
    "check_anchor_not_writable": (
        "anchor: {user} may not write {file}. Give that user write access to it, or name another file as "
        "anchor in [audit]."
    ),
}
