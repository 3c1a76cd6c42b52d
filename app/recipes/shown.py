"""Members of the API's responses about recipes, for its OpenAPI document."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import Time, UnitAddress
from app.web.message_shown import MessageShown

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


class DryRunStepShown(TypedDict):
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


class DryRunShown(TypedDict):
    """What loading a recipe now would do."""

    loadable: bool
    wire_s: Annotated[float, Field(description="Duration on the wire, seconds.")]
    ramp_s: RampS
    units: list[DryRunStepShown]


class DepartedShown(TypedDict):
    """A unit whose setpoint is no longer that of the recipe."""

    id: UnitAddress
    name: str
    recipe: Annotated[str, Field(description="Setpoint of the recipe, as displayed.")]
    now: Annotated[str, Field(description="Present setpoint, as displayed.")]
    now_message: MessageShown


class LoadedShown(TypedDict):
    """The recipe that a bus was loaded with last."""

    id: int
    name: str
    version: int
    who: str
    loaded_at: Time
    departed: list[DepartedShown]
