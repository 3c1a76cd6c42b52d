"""Recipes, dry runs and departures as the API returns them, with their schemas."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import Time, UnitAddress
from app.live.state.bus_live import BusLive
from app.recipes.rules import DryRun, Recipe, RecipeDeparture, setpoint_text
from app.recipes.store import Loaded
from app.web.shape import MessageShown, iso, maybe_shown, message_shown
from bus.messages import in_english, number, term

RampS = Annotated[float | None, Field(description="Duration of the ramp, seconds; null: not known.")]


class RecipeSetpointShown(TypedDict):
    """The setpoint of one unit."""

    raw: Annotated[int, Field(description="Integer on the wire, 0 to 99999.")]
    kind: Annotated[str, Field(description="speed, or ratio times 10000.")]
    value: Annotated[
        str | None, Field(description="As its unit displays it; null: not configured or not known.")
    ]


class RecipeShown(TypedDict):
    """One version of a recipe."""

    id: int
    bus: str
    name: str
    version: Annotated[int, Field(description="From 1 on.")]
    comment: str
    who: str
    saved_at: Time
    setpoints: Annotated[dict[str, RecipeSetpointShown], Field(description="By address of the unit.")]


class RecipeDryRunStep(TypedDict):
    """What loading a recipe does to one unit."""

    id: UnitAddress
    name: str
    raw: Annotated[int, Field(description="Setpoint on the wire, 0 to 99999.")]
    old: Annotated[str, Field(description="Present setpoint, as displayed.")]
    old_message: MessageShown
    new: Annotated[str, Field(description="Setpoint of the recipe, as displayed.")]
    ramp_s: RampS
    obstacle: Annotated[str, Field(description="Why it cannot be set, English; empty: it can.")]
    obstacle_message: Annotated[MessageShown | None, Field(description="obstacle as data.")]
    words: Annotated[str, Field(description="What happens, English; empty: it is not configured.")]
    words_message: Annotated[MessageShown | None, Field(description="words as data.")]


class RecipeDryRun(TypedDict):
    """What loading a recipe now would do."""

    loadable: bool
    wire_s: Annotated[float, Field(description="Duration on the wire, seconds.")]
    ramp_s: RampS
    units: list[RecipeDryRunStep]


class RecipeDepartureShown(TypedDict):
    """A unit whose setpoint is no longer that of the recipe."""

    id: UnitAddress
    name: str
    recipe: Annotated[str, Field(description="Setpoint of the recipe, as displayed.")]
    now: Annotated[str, Field(description="Present setpoint, as displayed.")]
    now_message: MessageShown


class LoadedRecipe(TypedDict):
    """The recipe that a bus was loaded with last."""

    id: int
    name: str
    version: int
    who: str
    loaded_at: Time
    departed: list[RecipeDepartureShown]


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


def dry_run_json(run: DryRun) -> RecipeDryRun:
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


def loaded_json(loaded: Loaded, departed: list[RecipeDeparture]) -> LoadedRecipe:
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
