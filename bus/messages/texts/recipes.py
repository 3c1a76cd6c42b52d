"""Texts about recipes."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
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
