"""Texts about parameter sets, batches, restores and recipes."""

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
    "changed_at_panel": "at the panel",
    "changed_by": "by {who}",
    "no_golden_set": "unit {unit} on {bus} has no golden set",
    "set_numbered": "set {set}",
    "set_of_unit": "set {set} of unit {unit}",
    "event_secret_exported": "set {set} was taken out with the operator password (#21) in clear",
    "unit_unread": "the unit does not respond",
    # Values and what their differences mean.
    "value_not_in_unit": "not in this unit",
    "value_secret": "secret",
    "value_not_known": "not known",
    "differs": "{new} instead of {old}",
    "differs_secret": "it differs; the secret value is not shown",
    "differs_max_rpm": "full scale is {new} instead of {old}",
    "differs_max_display": "shows {new} at full scale instead of {old}",
    "differs_decimals": "shows {new} decimals instead of {old}",
    "differs_base_ratio": "base ratio {new} instead of {old}",
    "differs_encoder": "its encoder gives {new} instead of {old}",
    "differs_acceleration": "accelerates in {new} instead of {old}",
    "differs_deceleration": "decelerates in {new} instead of {old}",
    "differs_mode": "runs as {new} instead of {old}",
    "differs_window": "is at speed within {new} instead of {old}",
    "differs_address": "has the address {new} instead of {old}",
    "differs_baud": "talks at {new} instead of {old}",
    "differs_max_ratio": "follows at {new} at most instead of {old}",
    "differs_min_ratio": "follows at {new} at least instead of {old}",
    # What writing a parameter does to a running machine.
    "effect_setpoint": "Changes the machine's speed now",
    "effect_speed_scale": "Changes the speed of the running unit immediately",
    "effect_ramp": "Changes the ramp of the running unit",
    "effect_contact": "Changes the speed immediately while the preset, up or down input is on",
    "effect_ratio_limit": "Changes the speed of a running follower whose ratio is outside the new limits",
    "effect_meaning": "Changes the meaning of the unit's setpoints",
    "effect_analog_output": (
        "Changes the analog output immediately, and the speed of the equipment that it drives"
    ),
    "effect_unknown": "May change the running unit: the manual does not explain this parameter",
    "effect_no_ramp": "Removes the ramp: the unit then changes its speed immediately",
    # Why a row is left out.
    "row_address": "the address is set at the keypad only; the link cannot write it",
    "row_not_in_unit": "this unit does not have it",
    "row_not_read": "it could not be read from the unit",
    "row_running": "no change while Run is on",
    "row_lacked_by_source": "the unit of the set did not have it",
    "row_secret": "secret, not stored in the set",
    "row_not_in_set": "the set does not contain it",
    "row_deselected": "left out by choice",
    "row_not_in_remote": (
        "the unit is not in REMOTE and rejects every write; set #19 to 1 at its keypad, then plan again"
    ),
    # Warnings before a restore.
    "restore_runs": "the unit runs: the marked rows change the speed of the machine immediately",
    "restore_may_run": (
        "whether the unit runs is not known: the marked rows may change the speed of the machine immediately"
    ),
    "restore_of_other_unit": ("the set is from unit {unit}, this is unit {present}: check every row"),
    "restore_of_master": ("the set is from a master, this unit is a follower (#8): another type of section"),
    "restore_of_follower": (
        "the set is from a follower, this unit is a master (#8): another type of section"
    ),
    "restore_source_lacks": "the unit of the set has {count} of {all} parameters only",
    "restore_unit_lacks": "this unit has {count} of {all} parameters only",
    # What became of a restore.
    "row_refused": "refused: {error}",
    "row_in_doubt": ("the server stopped before the result was known; the row may have been written"),
    "restore_under_way_at_end": "the server stopped during the restore",
    "restore_shut_down": "the server was shut down",
    "restore_failed": "server error; its log has the details",
    "restore_wrote_nothing": "no row differed; nothing was written",
    "rows_done": "done: {rows}",
    "rows_in_doubt": "not verified: {rows}",
    "rows_refused": "rejected: {rows}",
    "rows_not_written": "not written: {rows}",
    "rows_left_out": "left out: {rows}",
    # Recipes.
    "not_a_unit_address": "'{text}' is not a unit address; give 1 to 255",
    "no_recipe_with_id": "there is no recipe {recipe}",
    "no_setpoints_yet": "no setpoints were given, and no setpoint was read from any unit yet",
    "recipe_for_other_bus": "the recipe is for bus '{bus}', which is not configured",
    "recipe_unit_missing": "bus '{bus}' has no unit {unit}",
    "unit_mode_unknown": "the mode of unit {unit}, speed or ratio (#8), has not been read yet",
    "too_many_recipes": "{bus} has {most} recipes in use; retire one first",
    "no_such_recipe": "there is no recipe '{name}' for {bus}",
    "recipe_not_loadable": "{name} cannot be loaded now: {why}; nothing was sent",
    "decimals_and_mode_unknown": ("the decimals (#3) and the mode (#8) of {name} have not been read yet"),
    "nothing_saved": "{name}: {reason}; nothing was saved",
    "recipe_name_length": "a recipe has a name of 1 to 80 characters; nothing was saved",
    "recipe_without_setpoint": "no setpoint was given; nothing was saved",
    "unit_not_configured": "not in the configuration",
    "unit_address": "unit {unit}",
    "recipe_mode_unread": "its mode (#8) has not been read yet",
    "recipe_holds_speed": "the recipe holds a speed, the unit now takes a ratio (#8)",
    "recipe_holds_ratio": "the recipe holds a ratio, the unit now takes a speed (#8)",
    "recipe_sets": "becomes {new}; what it has now is not known",
    "recipe_keeps": "stays at {new}",
    "recipe_changes_ratio": "follows at {new} of its master instead of {old}",
    "recipe_speeds_up": "speeds up from {old} to {new}",
    "recipe_speeds_up_within": "speeds up from {old} to {new} in {seconds} s",
    "recipe_slows_down": "slows down from {old} to {new}",
    "recipe_slows_down_within": "slows down from {old} to {new} in {seconds} s",
}
