"""Each feature states itself: its services, its routes and its life."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest
from starlette.routing import Match, Route

import app
from app.core.database import Database
from app.core.lifespan import StartError
from app.engineering.recipes.book import RecipeBook
from app.errors import StoreError
from app.main import FEATURES, create_app
from bus.messages import Message
from tests.app.complete_app import settings_in

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
