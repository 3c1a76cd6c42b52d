"""What is said of unit replacement."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "swap_not_begun": "no swap of unit {unit} has been begun; begin it first",
    "swap_under_way": "{who} has begun a swap of unit {unit} already; go on with it or leave it first",
    "swap_without_set": "this swap has no set to restore from; enter the sheet, or leave it",
    "spare_not_chosen": "choose what the spare shall become; nothing was begun",
    # What to do now.
    "swap_reading": "reading the wire",
    "swap_old_or_new": (
        "A unit answers at address {target}. If it is the old one, switch it off and take it off the "
        "cable; this page goes on when the address is silent. If it is the spare already, say so."
    ),
    "swap_set_remote": (
        "At the keypad of the new unit set parameter 19 to 1 (REMOTE). In LOCAL it refuses every write, "
        "and the link cannot change that."
    ),
    "swap_restore_now": "The unit answers in REMOTE. Restore its parameters now.",
    "swap_proven": "The new unit is what the old one was, proven by a full read.",
    "swap_foreign": "Something that is no DIGIMAX IV answers at address {target}. Take it off the cable.",
    "swap_late": (
        "Responses from address {target} come too late to be identified. Increase turnaround_ms for this "
        "bus in lineside.toml and restart Lineside."
    ),
    "swap_two_units": (
        "Two units answer at address {target} at once. Take the old one off the cable, or give the other "
        "its own address at its keypad (parameter 17)."
    ),
    "swap_two_at_factory": (
        "Two units answer at address {factory}: the spare still has its factory address, which another "
        "section uses. At the keypad of the spare set parameter 17 to {target}."
    ),
    "swap_at_factory": (
        "The spare answers at its factory address {factory}. At its keypad set parameter 17 to {target}."
    ),
    "swap_nothing_new_other_baud": (
        "Nothing new answers yet. Connect and power the spare. Out of its box it speaks at 9600 baud, "
        "and this line goes at {baud}: at its keypad set parameter 17 to {target} and parameter 18 to "
        "{hundreds}, then switch it off and on."
    ),
    "swap_nothing_new": (
        "Nothing new answers yet. Connect and power the spare; at its keypad set parameter 17 to "
        "{target}. If it was used elsewhere before, set parameter 18 to {hundreds} ({baud} baud) as "
        "well, then switch it off and on."
    ),
    "swap_enter_sheet": (
        "The unit answers in REMOTE. Enter its parameters from the sheet, then let it be read whole and "
        "kept as a set."
    ),
    "swap_compare_with_sheet": (
        "The new unit has been read whole and is kept as a set; compare that with the sheet."
    ),
    "swap_restore_unfinished": (
        "The restore is not finished. Review it again: only the rows that still differ are written."
    ),
    # What the wire showed, and what was done.
    "swap_found_silent": "nothing answers at address {address}",
    "swap_found_digimax": "a unit answers at address {address}",
    "swap_found_remote": "a unit answers at address {address} in REMOTE",
    "swap_found_local": "a unit answers at address {address}, not in REMOTE",
    "swap_found_garbled": "two units answer at address {address}",
    "swap_found_foreign": "something that is no unit answers at address {address}",
    "swap_found_late": "responses come too late at address {address}",
    "swap_found_both": "{target} and {factory}",
    "swap_named_by_person": "a person said that it is the spare",
    "swap_seen": "seen in this order: {findings}",
    "swap_sheet": "the sheet",
    "swap_restored": "restored from {source}: {account}",
    "entered_from_sheet": "entered from the sheet",
    "kept_as_set": "kept as set {set}",
    "proven_by_full_read": "proven by a full read",
}
