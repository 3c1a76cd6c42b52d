"""What is said of parameter sets, batches and restores."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "secret_for_engineer": "the operator password (#21) is shown only to an engineer",
    "value_moved": "{name}: the value has changed since the review; nothing was sent",
    "value_not_writable": "a value cannot be written; nothing was sent",
    "parameter_not_writable": "there is no parameter {number} that can be written",
    "nested_too_deeply": "it is nested too deeply",
    "set_or_document": "give either set (a stored one) or document (a TOML file)",
    "source_lacks_unit": "{source} does not contain unit {unit}",
    "source_not_utf8": "{source} is not UTF-8 text: {why} at byte {n}; save it as UTF-8",
    "source_takes_unit_twice": ("{source}: a unit occurs twice; leave one [[unit]] for each address"),
    "source_no_parameter_set": "{source}: not a parameter set: it lacks format = {format}",
    "source_of_newer_version": (
        "{source}: written by a newer version of Lineside ({version}); update this installation"
    ),
    "source_key_too_deep": "{source}: a key has too many dotted parts",
    "source_cut_off": "{source}: not readable as TOML, perhaps cut off: {why}",
    "source_not_toml": "{source}: not readable as TOML: {why}",
    "source_fault": "{source}: {where}: {fault}",
    "source_time_unknown": "{source}: {time} is not a time of reading",
    "source_no_such_parameter": (
        "{source}: unit {unit}: there is no parameter '{key}'; a DIGIMAX IV has 1 to 40"
    ),
    "source_value_outside": (
        "{source}: unit {unit}: parameter {number} ({name}): {raw} is outside {lowest} to {highest}"
    ),
    "source_too_long": "{source} is too long for a parameter set",
    "no_such_set": "there is no parameter set {set}",
    "set_lacks_unit": "set {set} does not contain unit {unit}",
    "no_such_restore": (
        "no such restore; a plan that was not started ends when the server restarts: plan again"
    ),
    "no_such_taking": "no such reading; the server may have been restarted",
    "row_needs_confirmation": ("#{number}: {why}; confirm this row to write it; nothing was written"),
    "row_not_writable": "#{number} cannot be written: {why}",
    "unit_being_restored": ("another user is restoring unit {unit}; wait until that restore has finished"),
    "restore_has_begun": "this restore has started: it is {state}",
    "set_or_file_missing": "choose a stored set or a file",
    "no_row_chosen": "no row was chosen; nothing was written",
    "unit_changed_since_review": (
        "the unit has changed since the review; nothing was written, review it again"
    ),
    "unit_started_since_review": (
        "the unit was started after the review; the rest was not written, review it again"
    ),
    "row_included_and_excluded": "#{number} is both included and excluded; nothing was written",
    "no_such_side": "'{text}' is not a side of a comparison; give {known}",
    "not_a_set_number": "'{text}' is not the number of a set",
    "restore_left_off": Plural(
        "canceled by {who} after {done} of 1 row", "canceled by {who} after {done} of {n} rows"
    ),
    "at_row": "#{number}: {why}",
    "nothing_more_sent": "nothing more was sent",
    "no_golden_set": "unit {unit} on {bus} has no golden set",
}
