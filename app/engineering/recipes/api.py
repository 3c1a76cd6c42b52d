"""The HTTP API of recipes: list, save as versions, try out, load, their runs; and its schemas."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Request, Response
from pydantic import Field
from typing_extensions import TypedDict

from app.core.web.access import Person, Viewer
from app.core.web.api import ApiRoute
from app.core.web.arrival import made_at
from app.core.web.routes import SEARCH
from app.core.web.services import service
from app.core.web.shape import (
    Instant,
    MaybeInstant,
    StrictBody,
    UnitAddresses,
    ZonedTime,
    iso,
    parse_integer,
)
from app.engineering.recipes.book import DELETE, LOAD, SAVE, RecipeBook
from app.engineering.recipes.rules import Recipe, RecipeDeparture, RecipeDryRun, setpoints_now
from app.errors import Problem, or_404
from app.line.commands.api import RESULT_RESPONSES, FramesWanted, command_response
from app.line.commands.catalogue import SET_LINE
from app.line.commands.rules import setpoint_text
from app.line.commands.service import permitted_writer
from app.line.live.api.routes import Live
from app.line.live.api.view import Time
from app.line.live.bus_live import BusLive
from app.line.live.requests import bus_or_404
from app.people.audit.api import Events
from app.people.audit.entry import Event
from app.people.audit.log import Filter
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.validation import Lines, OneLine

router = APIRouter(prefix="/api/v1", tags=["recipes"], route_class=ApiRoute)

RecipeRaw = Annotated[int, Field(ge=0, le=99999)]


class SaveRecipeRequest(StrictBody):
    """A recipe to save. ``setpoints``: unit → raw; if empty, the present setpoints of the line."""

    name: Annotated[OneLine, Field(min_length=1, max_length=80)]
    comment: Annotated[Lines, Field(max_length=1000)] = ""
    setpoints: Annotated[dict[str, RecipeRaw], Field(max_length=255, default_factory=dict)]


class LoadRecipeRequest(StrictBody):
    """A load of a recipe. ``confirm``: the person has reviewed the steps for which the configuration asks.
    ``leave_out``: units that keep their setpoint; without it, all units change or none does."""

    confirm: bool = False
    leave_out: Annotated[UnitAddresses, Field(default_factory=list)]


class RecipeSetpointShown(TypedDict):
    """The setpoint of one unit."""

    raw: Annotated[int, Field(description="Integer on the wire, 0 to 99999.")]
    kind: Annotated[str, Field(description="speed, or ratio times 10000.")]
    value: Annotated[
        str | None, Field(description="As its unit displays it; null: not configured or not known.")
    ]


class RecipeShown(TypedDict):
    """A version of a recipe."""

    id: int
    bus: str
    name: str
    version: Annotated[int, Field(description="From 1 on.")]
    comment: str
    who: str
    saved_at: Time
    setpoints: Annotated[dict[str, RecipeSetpointShown], Field(description="By address of the unit.")]


class LoadedRecipe(TypedDict):
    """The recipe that was last loaded on a bus."""

    id: int
    name: str
    version: int
    who: str
    loaded_at: Time
    departed: list[RecipeDeparture]


MAX_LOADS = 1000
"""The number of newest loads that are searched for an earlier run."""


class RecipeRuns(TypedDict):
    """The run of a recipe at a time, and the run of the same recipe before that."""

    name: str
    loaded: Annotated[Instant, Field(description="When it was loaded, ISO 8601.")]
    before: Annotated[MaybeInstant, Field(description="When its run before began; null: it had none.")]


Book = Annotated[RecipeBook, service(RecipeBook)]


async def recipe_or_404(book: Book, recipe_id: int) -> Recipe:
    missing = Message.of("no_recipe_with_id", recipe=recipe_id)
    return or_404(await book.store.load(recipe_id), "unknown_recipe", missing)


KnownRecipe = Annotated[Recipe, Depends(recipe_or_404)]
"""The recipe version with the ``{recipe_id}`` of the path."""


@router.get("/recipes")
async def list_recipes(_: Viewer, book: Book, live: Live, bus: str | None = None) -> list[RecipeShown]:
    """List the newest version of each recipe in use, by name: at most 1000 for a bus."""
    return [_recipe_json(recipe, live.buses.get(recipe.bus)) for recipe in await book.store.newest(bus)]


@router.post("/buses/{bus}/recipes", status_code=201)
async def save_recipe(
    person: Annotated[Person, SAVE.permitted], book: Book, live: Live, bus: str, wanted: SaveRecipeRequest
) -> RecipeShown:
    """Save a new version of a recipe; older versions stay."""
    known = bus_or_404(live, bus)
    setpoints = _unit_setpoints(wanted.setpoints)
    if not setpoints:
        setpoints = {setpoint.unit: setpoint.raw for setpoint in setpoints_now(known, unix_now())}
    if not setpoints:
        raise Problem(422, "invalid", Message("no_setpoints_yet"))
    return _recipe_json(await book.save(person, bus, wanted.name, wanted.comment, setpoints), known)


@router.get("/recipes/{recipe_id}")
async def get_recipe(_: Viewer, live: Live, recipe: KnownRecipe) -> RecipeShown:
    """Return one version of a recipe."""
    return _recipe_json(recipe, live.buses.get(recipe.bus))


@router.get("/recipes/{recipe_id}/dry-run")
async def dry_run_recipe(person: Viewer, book: Book, recipe: KnownRecipe) -> RecipeDryRun:
    """Return the effect of loading the recipe now, unit by unit, and the time for sending and ramps."""
    return book.try_out(person, recipe)


@router.post("/recipes/{recipe_id}/load", responses=RESULT_RESPONSES)
async def load_recipe(
    request: Request,
    person: Annotated[Person, permitted_writer(SET_LINE)],
    book: Book,
    live: Live,
    recipe: KnownRecipe,
    wanted: LoadRecipeRequest,
    idempotency_key: Annotated[str | None, Header()] = None,
    frames: FramesWanted = False,
) -> Response:
    """Stage every unit, broadcast once, read back each unit."""
    sent_at = made_at(request)
    result = await book.load(
        person, recipe, sent_at, confirm=wanted.confirm, command_id=idempotency_key, left_out=wanted.leave_out
    )
    return command_response(request, bus_or_404(live, recipe.bus), result, frames=frames)


@router.get("/buses/{bus}/recipe")
async def get_loaded_recipe(_: Viewer, book: Book, live: Live, bus: str) -> LoadedRecipe | None:
    """Return the recipe last loaded on the bus, and the units whose setpoint has changed since."""
    bus_or_404(live, bus)
    loaded = book.loaded(bus)
    if loaded is None:
        return None
    return {
        "id": loaded.recipe.id,
        "name": loaded.recipe.name,
        "version": loaded.recipe.version,
        "who": loaded.who,
        "loaded_at": iso(loaded.at),
        "departed": book.departed(bus),
    }


@router.get("/buses/{bus}/recipe/runs", dependencies=[SEARCH])
async def get_recipe_runs(
    _: Viewer, events: Events, live: Live, bus: str, at: ZonedTime | None = None
) -> RecipeRuns | None:
    """Return the recipe that ran at a time (or now), since when, and its previous run; null if none ran."""
    bus_or_404(live, bus)
    until = UnixTime(at.timestamp()) if at is not None else None
    wanted = Filter(kind=LOAD.kind, bus=bus, code=LOAD.event, until=until)
    found, _next = await events.page(wanted, MAX_LOADS)
    return runs_of(found)


@router.delete("/buses/{bus}/recipes/{name}", status_code=204)
async def delete_recipe(person: Annotated[Person, DELETE.permitted], book: Book, bus: str, name: str) -> None:
    """Take a recipe out of the list; its versions stay on record."""
    await book.retire(person, bus, name)


def _recipe_json(recipe: Recipe, bus: BusLive | None) -> RecipeShown:
    """Return one version as JSON, with setpoints as configured units show them."""
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
                "value": setpoint_text(bus.units[setpoint.unit], setpoint.raw, setpoint.kind)
                if bus is not None and setpoint.unit in bus.units
                else None,
            }
            for setpoint in recipe.setpoints
        },
    }


def _unit_setpoints(given: dict[str, int]) -> dict[int, int]:
    """Convert the keys of JSON to addresses. Raise Problem 422 for a key that is not one."""
    wrong = next((key for key in given if not 1 <= (parse_integer(key) or 0) <= 255), None)
    if wrong is not None:
        raise Problem(422, "invalid", Message.of("not_a_unit_address", text=wrong))
    return {int(key): raw for key, raw in given.items()}


def runs_of(loads: Sequence[Event]) -> RecipeRuns | None:
    """Find the newest run of a recipe in ``loads``, newest first, and the run of the same recipe before that.

    A run lasts until another recipe is loaded; loading the same recipe again continues its run.
    """
    runs = [
        (name, min(load["time"] for load in run))
        for name, run in groupby(loads, lambda load: str(load["messages"]["what"].params["name"]))
    ]
    if not runs:
        return None
    name, loaded = runs[0]
    before = next((start for earlier, start in runs[1:] if earlier == name), None)
    return {"name": name, "loaded": iso(loaded), "before": None if before is None else iso(before)}
