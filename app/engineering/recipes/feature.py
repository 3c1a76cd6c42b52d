"""The feature of recipes and its pages: the list, one recipe with its dry run, save, load."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from starlette.responses import RedirectResponse

from app.core.database import Database
from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.core.web.access import Person, Viewer
from app.core.web.routes import GuardedRoute
from app.core.web.templating import render
from app.engineering.recipes import api
from app.engineering.recipes.api import Book, KnownRecipe
from app.engineering.recipes.book import ACTS, DELETE, SAVE, RecipeBook, RecipeStore
from app.engineering.recipes.rules import setpoint_kind, setpoints_now
from app.errors import Problem
from app.feature import Feature, Services
from app.line.commands.catalogue import SET_LINE, longest_change_s
from app.line.commands.page_context import Confirmed, Page
from app.line.commands.pages.line import followers_of, left_out_of, proven, refuse_outsiders, reviewed
from app.line.commands.review import by_remark, draw_changes, present_setpoint
from app.line.commands.rules import setpoint_text
from app.line.commands.service import CommandService, permitted
from app.line.live.api.routes import Live
from app.line.live.bus_live import BusLive, LiveState, unit_link_now
from app.line.live.requests import bus_or_404
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from bus.catalogue.parameters import DECIMALS
from bus.catalogue.values import ratio_raw, speed_raw
from bus.errors import CallerError
from bus.instants import unix_now
from bus.messages import Message
from bus.validation import Lines, OneLine

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@router.get("/recipes")
async def list_page(request: Request, _: Viewer, book: Book, live: Live) -> Response:
    """List the recipes in use and the loaded ones, with a form that saves the present line."""
    return await _list(request, book, live)


async def _list(
    request: Request,
    book: RecipeBook,
    live: LiveState,
    opened: str = "",
    typed: Mapping[str, str] | None = None,
    errors: Mapping[str, Message] | None = None,
) -> Response:
    """Show the list of recipes. ``opened``: the bus whose form was refused; ``typed``: its texts; ``errors``:
    by field."""
    return render(
        request,
        "recipes/page.html",
        status=422 if errors else 200,
        opened=opened,
        typed=defaultdict(str, typed or {}),
        errors=defaultdict(str, errors or {}),
        buses=live.buses,
        recipes=await book.store.newest(),
        loaded={name: book.loaded(name) for name in live.buses},
        departed={name: book.departed(name) for name in live.buses},
        setpoints={name: _present(bus) for name, bus in live.buses.items()},
        silent={name: _silent(bus) for name, bus in live.buses.items()},
    )


@router.post("/recipes/save")
async def save(
    request: Request,
    person: Annotated[Person, SAVE.permitted],
    book: Book,
    live: Live,
    name: Annotated[OneLine, Form()] = "",
    comment: Annotated[Lines, Form()] = "",
) -> Response:
    """Save a new version with the typed setpoints; an empty field leaves its unit out."""
    form = await request.form()
    bus = bus_or_404(live, str(form.get("bus", "")))
    name, bus_name = name.strip(), bus.settings.name
    typed = {f"unit-{unit}": str(form.get(f"unit-{unit}", "")).strip() for unit in bus.units}
    errors = {} if 1 <= len(name) <= 80 else {"name": Message("recipe_name_length")}
    setpoints = {}
    for unit in bus.units:
        try:
            if text := typed[f"unit-{unit}"]:
                setpoints[unit] = _raw(bus, unit, text)
        except Problem as problem:
            errors[f"unit-{unit}"] = problem.message
    if not setpoints and not errors:
        errors["form"] = Message("recipe_without_setpoint")
    if errors:
        return await _list(request, book, live, bus_name, {"name": name, "comment": comment, **typed}, errors)
    saved = await book.save(person, bus_name, name, comment[:1000], setpoints)
    return RedirectResponse(f"/recipes/{saved.id}", 303)


@router.get("/recipes/{recipe_id}")
async def one_page(request: Request, person: Viewer, book: Book, recipe: KnownRecipe) -> Response:
    """Show one version, the effect of loading it now, and the other versions."""
    return render(
        request,
        "recipes/one.html",
        recipe=recipe,
        run=book.try_out(person, recipe),
        versions=await book.store.versions(recipe.bus, recipe.name),
    )


@router.get("/recipes/{recipe_id}/review")
async def review(
    person: Annotated[Person, permitted(SET_LINE)], page: Page, book: Book, recipe: KnownRecipe
) -> Response:
    """Show a review of the effect of loading the recipe."""
    of_bus = page.of_bus(recipe.bus)
    bus = of_bus.bus
    await of_bus.know_ramps([one.unit for one in recipe.setpoints if one.unit in bus.units])
    run = book.try_out(person, recipe)
    able = [step for step in run.steps if step.obstacle is None]
    try:
        if able:
            refuse_outsiders(of_bus, [step.unit for step in able])
    except Problem as problem:
        return of_bus.refused(problem, recipe.name)
    was = {number: present_setpoint(bus, unit) for number, unit in bus.units.items()}
    left_out, unchanged = of_bus.not_taking_part(step.unit for step in run.steps)
    return page.review(
        "recipes/_review.html",
        recipe=recipe,
        run=run,
        was=was,
        followers=followers_of(bus),
        able=len(able),
        draws=draw_changes(of_bus.bus, {step.unit: step.raw for step in able}),
        risks=by_remark((str(step.name), risk) for step in able for risk in step.risks),
        left_out=by_remark(left_out),
        unchanged=unchanged,
        longest_s=longest_change_s(bus, len(run.steps)),
    )


@router.post("/recipes/{recipe_id}/load")
async def load(
    request: Request,
    person: Annotated[Person, permitted(SET_LINE)],
    page: Page,
    book: Book,
    recipe: KnownRecipe,
    confirmed: Confirmed,
) -> Response:
    """Load the recipe: stage every unit, broadcast once, read back each unit."""
    of_bus, form = page.of_bus(recipe.bus), await request.form()
    try:
        is_sent = await of_bus.has_sent(confirmed.id)
        if not is_sent:
            confirmed.refuse_lapsed()
        setpoints, scales = reviewed(of_bus.bus, form, is_sent=is_sent)
        left_out = left_out_of(form)
        if setpoints != {
            one.unit: one.raw
            for one in recipe.setpoints
            if one.unit in of_bus.bus.units and one.unit not in left_out
        }:
            raise Problem(422, "invalid", Message("not_what_was_reviewed"))
        result = await book.load(
            person,
            recipe,
            page.made_at,
            confirm=True,
            command_id=confirmed.id,
            left_out=left_out,
            scales=scales,
        )
    except Problem as problem:
        return of_bus.not_sent(problem)
    return proven(of_bus, setpoints, result, confirmed.id, left_out)


@router.get("/recipes/{recipe_id}/retire")
async def review_retirement(
    request: Request, _: Annotated[Person, DELETE.permitted], recipe: KnownRecipe
) -> Response:
    """Show a review of taking a recipe out of the list."""
    return render(request, "recipes/_review_retire.html", recipe=recipe)


@router.post("/recipes/{recipe_id}/retire")
async def retire(person: Annotated[Person, DELETE.permitted], book: Book, recipe: KnownRecipe) -> Response:
    """Take a recipe out of the list; its versions stay on record."""
    await book.retire(person, recipe.bus, recipe.name)
    return RedirectResponse("/recipes", 303)


def _silent(bus: BusLive) -> list[str]:
    """Return the names of the units that do not respond now."""
    now = unix_now()
    return [unit.settings.name for unit in bus.units.values() if unit_link_now(bus, unit, now) == "offline"]


def _present(bus: BusLive) -> dict[int, str]:
    """Return the present setpoint of each unit as text; empty if it is not known, or nothing reports it."""
    known = {
        one.unit: setpoint_text(bus.units[one.unit], one.raw, one.kind)
        for one in setpoints_now(bus, unix_now())
    }
    return dict.fromkeys(bus.units, "") | known


def _raw(bus: BusLive, number: int, text: str) -> int:
    unit = bus.units[number]
    kind, decimals = setpoint_kind(unit), unit.parameter_raw(DECIMALS)
    if kind is None or decimals is None:
        raise Problem(422, "invalid", Message.of("decimals_and_mode_unknown", name=unit.settings.name))
    try:
        return ratio_raw(text) if kind == "ratio" else speed_raw(text, decimals)
    except CallerError as error:
        reason = Message.of("nothing_saved", name=unit.settings.name, reason=error.message)
        raise Problem(422, "invalid", reason) from error


def make(services: Services) -> None:
    commands, store = services.of_buses(CommandService), RecipeStore(services[Database])
    recipes = services.add(RecipeBook(services[LiveState], commands, store, services[EventLog]))
    services[Finders].add("find_recipes", partial(find_recipes, store))
    for name in services.buses:
        services[Sources].recipes[name] = partial(recipes.loaded_words, name)
    services.lifespan.add("recipes", start=recipes.load_marks)


async def find_recipes(store: RecipeStore, search: Search) -> Iterable[FoundPlace]:
    """Find recipes in use by name or comment."""
    return [
        place
        for recipe in await store.newest()
        for place in matched(
            search,
            FoundPlace(recipe.name, f"/recipes/{recipe.id}", recipe.bus, is_name=True),
            recipe.name,
            recipe.comment,
        )
    ]


FEATURE = Feature(make, (api.router, router), ACTS)
