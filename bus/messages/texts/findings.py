"""What a scan finds at an address, and the likely cause of what is wrong on a bus."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
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
    "check_notify_mail": "mail server {address} responds",
    "check_notify_webhook": "webhook {address} responds",
    "check_notify_apprise": "apprise knows the URL of {address}",
    "check_notify_failed": "notification by {address}: {reason}",
    "check_notify_no_links": (
        "notify.dashboard_url is not set: messages of alarms have no link to acknowledge them"
    ),
    "check_secret_open": "{path} can be read by every user of this machine: run chmod o= {path}",
}
