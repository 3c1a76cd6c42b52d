"""Texts about lineside.toml, and what ``lineside check`` finds of it on this machine."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "configuration_exists": (
        "{file} exists and is kept. Name another file with --config, or move this one away."
    ),
    "configuration_not_writable": (
        "{file} cannot be written: {error}. Create its folder, or name another file with --config."
    ),
    "configuration_key_in_data": (
        "{file}: audit.key_file = '{path}' is in the data folder: anyone who can write the log "
        "there could seal it; name a file in another folder"
    ),
    "configuration_lacks_bus": "{file}: there is no [[bus]] named '{bus}'; it has {known}",
    "configuration_missing": "{file}: there is no such file; name one with --config FILE",
    "configuration_beyond_bounds": (
        "{file}: a number in it has too many digits or a list too many brackets; compare the file "
        "that 'lineside init' writes"
    ),
    "configuration_not_utf8": "{file}: this is not UTF-8 text; save it as that",
    "configuration_unreadable": "{file}: cannot be read: {error}",
    "configuration_not_toml": (
        '{file}:{line}: this is not TOML: {error}; the line is {text}; write key = value, text in "quotes"'
    ),
    "configuration_fault": "{file}:{line}: {fault}",
    "configuration_needs_key": "{table} needs {key} = …",
    "configuration_needs_array": "write [[{table}]] instead of [{table}], as there may be several",
    "configuration_value": "{key} = {value}: {right}",
    "configuration_slug": "write small letters, digits and hyphens between them, like dry-end",
    "configuration_key_near": "did you mean {key}?",
    "setting_integer": "write an integer, without quotes",
    "setting_device_path": "write a device path, such as one in /dev/serial/by-id/",
    "setting_port_scheme": "write a device path, socket://host:port or rfc2217://host:port",
    "setting_host_and_port": "write host and port number, like socket://192.168.0.7:4001",
    "setting_unit_twice": "unit id {unit} is given twice; every unit on a bus has its own (#17)",
    "setting_bus_twice": "bus name {name} is given twice; every bus has its own",
    "setting_port_twice": "port {port} belongs to bus {other} already; every bus has its own port",
    "setting_time_zone": "write a time zone like Europe/Berlin, or leave it out for the machine's own",
    "setting_one_of": "write one of {known}",
    "setting_proxy": "write the address of a proxy, like 10.0.0.5, or its network, like 10.0.0.0/28",
    "setting_every_proxy": "name the proxies; with all addresses any client could write X-Forwarded-For",
    "setting_host_name": "write a name or an address without scheme and port, like mill.example",
    "setting_idle_hours": "idle_hours is longer than total_days; write fewer hours or more days",
    "setting_panel_idle_days": "panel_idle_days is longer than panel_total_days; write at most as many",
    "configuration_keys_known": "known here: {keys}",
    "configuration_key_unknown": "unknown key {key} in {table}; {right}",
    "setting_alarm_of_bit": 'alarm {name}: {value} is on or off; write state = "on" or "off", no limit',
    "setting_alarm_of_number": "alarm {name}: {value} is a number; write above or below instead of state",
    "setting_alarm_one_state": 'alarm {name}: write state = "on" or "off"',
    "setting_alarm_one_limit": "alarm {name}: write one condition: above, below or both, or change_per_s",
    "setting_alarm_deadband_of_rate": (
        "alarm {name}: deadband belongs to above and below; use off_delay_s with change_per_s"
    ),
    "setting_alarm_limits_reversed": "alarm {name}: below is not less than above; no value would be inside",
    "setting_alarm_deadband_wide": (
        "alarm {name}: deadband is wider than the limits leave room for; the alarm would never clear"
    ),
    "setting_alarm_bus": "alarm {name}: there is no bus {bus}; name one that is configured",
    "setting_alarm_unit": "alarm {name}: bus {bus} has no unit {unit}; name one that is configured",
    "setting_alarm_name": "alarm {name} is given twice for bus {bus}; give each its own name",
    "setting_built_in_of_server": "alarm {name} is of the server; leave out bus and unit",
    "setting_built_in_of_bus": "alarm {name} is not of one unit; leave out unit",
    "setting_built_in_bus_missing": "alarm {name}: units of several buses have this number; name the bus",
    "setting_built_in_key": "alarm {name} has no {key}; known here: {keys}",
    "setting_built_in_empty": "alarm {name}: nothing is set; write one of {keys}",
    "setting_built_in_twice": "alarm {name} is set twice for one place; write one entry for both",
    "setting_mail_address": "write one e-mail address of ASCII characters, such as duty@plant.example",
    "setting_day": "write a day without quotes, such as 2027-03-31",
    "setting_clock_time": "write hours and minutes of the day, such as 06:30",
    "setting_web_url": "write a URL that begins with https:// or http://",
    "setting_url_with_password": "leave user and password out of the URL",
    "setting_mail_password_open": (
        'security "none" would send the password unencrypted; use "starttls" or "tls", or leave user out'
    ),
    "setting_webhook_url": "write either url or url_file",
    "setting_group_empty": "group {name} has no one; give it to, or a duty",
    "setting_group_twice": "group {name} is given twice; give each its own name",
    "setting_mail_server_missing": "people are notified by e-mail; add [notify.smtp] with host and sender",
    "setting_rule_group": "there is no group {name}; add a [[notify.group]] of this name",
    "setting_notify_bus": "there is no bus {bus}; name one that is configured",
    # What ``lineside check`` finds of a configuration on this machine.
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
    "check_disk_read_only": (
        "the disk of {path} is mounted read-only. Check it, and mount it so that it can be written."
    ),
    "check_disk_full": (
        "the disk of {folder} is full: {free} MB are free, and below {reserve} MB no history is stored. Free "
        "some space."
    ),
    "check_disk_low": "the disk of {folder} is nearly full: {free} MB are free",
    "check_store": "store {path}, {size} MB",
    "check_store_damaged": (
        "the store {path} is damaged ({verdict}). Check the disk, and put a backup back with 'lineside "
        "restore-store'."
    ),
    "check_store_refused": "{reason}",
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
    "setting_shift_twice": "{time} starts two shifts",
}
