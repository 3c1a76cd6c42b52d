"""Recipes, dry runs and departures as JSON."""

from __future__ import annotations

from app.live.state.bus_live import BusLive
from app.recipes.rules import DryRun, Recipe, RecipeDeparture, setpoint_text
from app.recipes.shown import DryRunShown, LoadedShown, RecipeShown
from app.recipes.store import Loaded
from app.web.message_shown import maybe_shown, message_shown
from app.web.shape import iso
from bus.messages import in_english, number, term


def recipe_json(recipe: Recipe, bus: BusLive | None) -> RecipeShown:
    """One version; setpoints also as their units show them, where the unit is configured."""
    return {
        "id": recipe.id,
        "bus": recipe.bus,
        "name": recipe.name,
        "version": recipe.version,
        "comment": recipe.comment,
        "who": recipe.who,
        "saved_at": iso(recipe.saved_at),
        "setpoints": {
            str(setpoint.unit): {
                "raw": setpoint.raw,
                "kind": setpoint.kind,
                "value": setpoint_text(bus.units[setpoint.unit], setpoint)
                if bus is not None and setpoint.unit in bus.units
                else None,
            }
            for setpoint in recipe.setpoints
        },
    }


def dry_run_json(run: DryRun) -> DryRunShown:
    """What loading would do. Times in seconds."""
    return {
        "loadable": run.loadable,
        "wire_s": round(run.wire_s, 3),
        "ramp_s": None if run.ramp_s is None else round(run.ramp_s, 1),
        "units": [
            {
                "id": step.unit,
                "name": str(step.name),
                "raw": step.raw,
                "old": str(old),
                "old_message": message_shown(old),
                "new": step.new,
                "ramp_s": None if step.ramp_s is None else round(step.ramp_s, 1),
                "obstacle": in_english(step.obstacle),
                "obstacle_message": maybe_shown(step.obstacle),
                "words": in_english(step.effect),
                "words_message": maybe_shown(step.effect),
            }
            for step, old in ((step, number(step.old) if step.old else term("unknown")) for step in run.steps)
        ],
    }


def loaded_json(loaded: Loaded, departed: list[RecipeDeparture]) -> LoadedShown:
    """Which recipe a bus was loaded with, and which units no longer command it."""
    return {
        "id": loaded.recipe.id,
        "name": loaded.recipe.name,
        "version": loaded.recipe.version,
        "who": loaded.who,
        "loaded_at": iso(loaded.at),
        "departed": [
            {
                "id": one.unit,
                "name": str(one.name),
                "recipe": one.recipe,
                "now": str(one.now),
                "now_message": message_shown(one.now),
            }
            for one in departed
        ],
    }
