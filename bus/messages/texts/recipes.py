"""What is said of recipes."""

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
}
