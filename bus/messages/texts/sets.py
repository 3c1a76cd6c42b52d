"""What is said of parameter sets, batches and restores."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "secret_for_engineer": "the operator password (#21) is given to an engineer only",
    "value_moved": "{name}: the value has moved since it was reviewed; nothing was sent",
    "value_not_writable": "a value cannot be written; nothing was sent",
    "parameter_not_writable": "there is no parameter {number} that can be written",
    "nested_too_deeply": "it is nested too deeply",
    "set_or_document": "give either set (a stored one) or document (a TOML file)",
    "source_lacks_unit": "{source} does not hold unit {unit}",
    "source_not_utf8": "{source} is no text in UTF-8: {why} at byte {n}; save it as UTF-8",
    "source_too_long": "{source} is too long for a parameter set",
    "no_such_set": "there is no parameter set {set}",
    "set_lacks_unit": "set {set} does not hold unit {unit}",
    "no_such_restore": "no such restore; a plan that was not begun ends with the server: plan again",
    "no_such_taking": "no such reading; the server may have been started anew",
    "row_needs_confirmation": "#{number}: {why}; confirm it by itself to write it; nothing was written",
    "row_not_writable": "#{number} cannot be written: {why}",
    "unit_being_restored": "unit {unit} is being restored by another; wait for its end",
    "restore_has_begun": "this restore has begun: it is {state}",
    "set_or_file_missing": "choose a stored set or a file",
    "no_row_chosen": "no row was chosen; nothing was written",
    "unit_changed_since_review": (
        "the unit has changed since the review; nothing was written, review it again"
    ),
    "unit_started_since_review": (
        "the unit was started after the review; the rest was not written, review it again"
    ),
    "row_included_and_excluded": "#{number} is both included and excluded; nothing was written",
    "no_such_side": "'{text}' names no side; give {known}",
    "not_a_set_number": "'{text}' is no number of a set",
    "restore_left_off": Plural(
        "left off by {who} after {done} of 1 row", "left off by {who} after {done} of {n} rows"
    ),
    "at_row": "#{number}: {why}",
    "nothing_more_sent": "nothing more was sent",
    "no_golden_set": "no set of unit {unit} on {bus} is marked golden",
}
