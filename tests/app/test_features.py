"""Each feature states its services, its routes and its life, and routes find the services."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from inspect import isasyncgenfunction, iscoroutinefunction
from pathlib import Path

import pytest
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.routing import Match, Route

import app
from app.core.database import Database
from app.core.lifespan import StartError
from app.core.web.access import Requires
from app.core.web.services import Registry
from app.engineering.recipes.book import RecipeBook
from app.errors import StoreError
from app.main import FEATURES, create_app
from bus.messages import Message
from tests.app.complete_app import complete_app, settings_in

FOLDER = Path(app.__file__).parent


def test_every_feature_is_served() -> None:
    stated = [path.relative_to(FOLDER).parent for path in FOLDER.glob("*/**/feature.py")]
    found = [import_module(".".join(("app", *folder.parts, "feature"))).FEATURE for folder in stated]
    assert len(found) > 10
    assert sorted(map(id, FEATURES)) == sorted(map(id, found))


def test_no_route_is_hidden_by_one_of_an_earlier_feature(tmp_path: Path) -> None:
    routes = [each for each in create_app(settings_in(tmp_path)).routes if isinstance(each, Route)]
    assert len(routes) > 100
    for route in routes:
        scope = {"type": "http", "path": re.sub(r"\{[^}]*\}", "9", route.path), "root_path": ""}
        scope["method"] = min(route.methods or ())
        assert next(each for each in routes if each.matches(scope)[0] is Match.FULL) is route


async def test_a_feature_that_cannot_start_is_named_and_the_stores_are_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(_: RecipeBook) -> None:
        raise StoreError(Message("store_is_damaged"))

    monkeypatch.setattr(RecipeBook, "load_marks", fail)
    services = create_app(settings_in(tmp_path)).state.services
    with pytest.raises(StartError, match="could not start: recipes: "):
        async with services.lifespan.running():
            pytest.fail("it started")
    with pytest.raises(StoreError, match="closed"):
        await services[Database].read(lambda _: None)


async def test_no_route_waits_for_a_thread_to_look_something_up(tmp_path: Path) -> None:
    """FastAPI sends a plain function to a thread; a press of an operator would wait there."""
    async with complete_app(tmp_path) as house:
        routes = [route for route in house.app.routes if isinstance(route, APIRoute | APIWebSocketRoute)]
    assert len(routes) > 100
    plain = {
        f"{route.path}: {call}"
        for route in routes
        for call in calls_of(route.dependant)
        if not (iscoroutinefunction(call) or isasyncgenfunction(call) or isinstance(call, Requires))
    }
    assert plain == set()


def calls_of(dependant: Dependant) -> Iterator[object]:
    """What FastAPI calls for a request: its dependencies, theirs, and the route's own function."""
    yield dependant.call
    for needed in dependant.dependencies:
        yield from calls_of(needed)


def test_a_service_is_found_by_its_type() -> None:
    registry = Registry(("text", 1))
    assert (registry[str], registry[int]) == ("text", 1)
    with pytest.raises(KeyError):
        registry[float]


def test_two_services_of_one_type_are_refused() -> None:
    with pytest.raises(RuntimeError, match="two services of the type int"):
        Registry(("text", 1, 2))
    Registry(("text",), {"dry-end": (1,), "wet-end": (2,)})


def test_a_service_is_added_once() -> None:
    services = Registry(("text",), {"dry-end": (1,), "wet-end": (2,)})
    assert services.add(2.5) == services[float]
    assert services.of_buses(int) == {"dry-end": 1, "wet-end": 2}
    with pytest.raises(RuntimeError, match="two services of the type float"):
        services.add(3.5)
