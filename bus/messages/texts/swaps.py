"""Texts about unit replacement."""

TEXTS = {
    "swap_not_begun": "no swap of unit {unit} is started; start it first",
    "swap_under_way": ("{who} has already started a swap of unit {unit}; continue it or cancel it first"),
    "swap_without_set": (
        "this swap has no set to restore from; enter the parameter sheet, or cancel the swap"
    ),
    "spare_not_chosen": "choose the source of the parameters; the swap was not started",
    # What to do now.
    "swap_reading": "reading the bus",
    "swap_old_or_new": (
        "A unit responds at address {target}. If it is the old unit, switch it off and "
        "disconnect it; this page continues when the address stops responding. If it is already "
        "the spare, confirm it."
    ),
    "swap_set_remote": (
        "At the keypad of the new unit, set parameter 19 to 1 (REMOTE). In LOCAL it rejects "
        "every write, and the link cannot change that."
    ),
    "swap_restore_now": "The unit responds and is in REMOTE. Restore its parameters now.",
    "swap_proven": "The new unit has the parameters of the old unit, verified by a full read.",
    "swap_foreign": (
        "A device that is not a DIGIMAX IV responds at address {target}. Disconnect it from the cable."
    ),
    "swap_late": (
        "Responses from address {target} arrive too late to be identified. Increase "
        "turnaround_ms for this bus in lineside.toml and restart Lineside."
    ),
    "swap_two_units": (
        "Two units respond at address {target}. Disconnect the old unit, or set a unique address "
        "at the keypad of the other (parameter 17)."
    ),
    "swap_two_at_factory": (
        "Two units respond at address {factory}: the spare still has its factory address, which "
        "another section uses. At the keypad of the spare, set parameter 17 to {target}."
    ),
    "swap_at_factory": (
        "The spare responds at its factory address {factory}. At its keypad, set parameter 17 to {target}."
    ),
    "swap_nothing_new_other_baud": (
        "No spare responds yet. Connect and power the spare. Its factory setting is 9600 baud, "
        "and this line runs at {baud}: at its keypad, set parameter 17 to {target} and parameter "
        "18 to {hundreds}, then switch it off and on."
    ),
    "swap_nothing_new": (
        "No spare responds yet. Connect and power the spare; at its keypad, set parameter 17 to "
        "{target}. If it was used elsewhere before, also set parameter 18 to {hundreds} ({baud} "
        "baud), then switch it off and on."
    ),
    "swap_enter_sheet": (
        "The unit responds and is in REMOTE. Enter the values of the parameter sheet, then read "
        "the unit and save it as a set."
    ),
    "swap_compare_with_sheet": (
        "All parameters of the new unit were read and saved as a set. Compare the set with the "
        "parameter sheet."
    ),
    "swap_restore_unfinished": (
        "The restore is not complete. Review it again: only the rows that still differ are written."
    ),
    # What the wire showed, and what was done.
    "swap_found_silent": "no response at address {address}",
    "swap_found_digimax": "a unit responds at address {address}",
    "swap_found_remote": "a unit responds at address {address} in REMOTE",
    "swap_found_local": "a unit responds at address {address}, not in REMOTE",
    "swap_found_garbled": "two units respond at address {address}",
    "swap_found_foreign": "a device that is not a unit responds at address {address}",
    "swap_found_late": "responses from address {address} arrive too late",
    "swap_found_both": "{target} and {factory}",
    "swap_named_by_person": "a user confirmed the spare",
    "swap_seen": "seen in this order: {findings}",
    "swap_sheet": "the parameter sheet",
    "swap_restored": "restored from {source}: {account}",
    "entered_from_sheet": "entered from the parameter sheet",
    "kept_as_set": "saved as set {set}",
    "proven_by_full_read": "verified by a full read",
}
