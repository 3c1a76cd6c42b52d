"""Setpoint recipes."""

from __future__ import annotations

from functools import partial

from app.audit.log import EventLog
from app.commands.service.command_service import CommandService
from app.database import Database
from app.feature import Feature, Services
from app.find.finders import Finders
from app.live.state.bus_live import LiveState
from app.recipes import api, pages
from app.recipes.acts import ACTS
from app.recipes.book import RecipeBook
from app.recipes.finding import RecipeFinder
from app.recipes.store import RecipeStore


def make(services: Services) -> None:
    commands, store = services.of_buses(CommandService), RecipeStore(services[Database])
    recipes = services.add(RecipeBook(services[LiveState], commands, store, services[EventLog]))
    services[Finders].add("find_recipes", RecipeFinder(store))
    for name in services.buses:
        services.lifespan.add(f"recipes of {name}", start=partial(recipes.load_mark, name))


FEATURE = Feature(make, (api.router, pages.router), ACTS)
