"""Setpoint recipes."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from app.core.database import Database
from app.core.find.finders import Finders, FoundPlace, Search, matched
from app.engineering.recipes import api, pages
from app.engineering.recipes.book import ACTS, RecipeBook, RecipeStore
from app.feature import Feature, Services
from app.line.commands.service import CommandService
from app.line.live.bus_live import LiveState
from app.line.live.sources import Sources
from app.people.audit.log import EventLog


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


FEATURE = Feature(make, (api.router, pages.router), ACTS)
