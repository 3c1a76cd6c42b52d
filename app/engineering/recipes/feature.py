"""Setpoint recipes."""

from __future__ import annotations

from functools import partial

from app.core.database import Database
from app.core.find.finders import Finders
from app.engineering.recipes import api, pages
from app.engineering.recipes.acts import ACTS
from app.engineering.recipes.book import RecipeBook
from app.engineering.recipes.finding import RecipeFinder
from app.engineering.recipes.store import RecipeStore
from app.feature import Feature, Services
from app.line.commands.service.command_service import CommandService
from app.line.live.state.bus_live import LiveState
from app.people.audit.log import EventLog


def make(services: Services) -> None:
    commands, store = services.of_buses(CommandService), RecipeStore(services[Database])
    recipes = services.add(RecipeBook(services[LiveState], commands, store, services[EventLog]))
    services[Finders].add("find_recipes", RecipeFinder(store))
    for name in services.buses:
        services.lifespan.add(f"recipes of {name}", start=partial(recipes.load_mark, name))


FEATURE = Feature(make, (api.router, pages.router), ACTS)
