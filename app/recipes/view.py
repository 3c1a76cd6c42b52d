"""Recipes as the API returns them, with their schemas."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import Time
from app.live.state.bus_live import BusLive
from app.recipes.rules import Recipe, RecipeDeparture, setpoint_text
from app.recipes.store import Loaded
from app.web.shape import iso


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


class LoadedRecipe(TypedDict):
    """The recipe that a bus was loaded with last."""

    id: int
    name: str
    version: int
    who: str
    loaded_at: Time
    departed: list[RecipeDeparture]


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


def loaded_json(loaded: Loaded, departed: list[RecipeDeparture]) -> LoadedRecipe:
    """Which recipe a bus was loaded with, and which units no longer command it."""
    return {
        "id": loaded.recipe.id,
        "name": loaded.recipe.name,
        "version": loaded.recipe.version,
        "who": loaded.who,
        "loaded_at": iso(loaded.at),
        "departed": departed,
    }
