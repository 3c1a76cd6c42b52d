"""The stage that many tests use, and its worker, which does nothing until the test sets its play."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from app.database import Database
from tests.app.stage import PlayedWorker, Stage, staged
from tests.stores import ENGINES, Engine, open_store, used


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Take away what a module with `both_engines` leaves to SQLite."""
    items[:] = [
        item for item in items if not (item.get_closest_marker("only_sqlite") and _is_postgresql(item))
    ]


def _is_postgresql(item: pytest.Item) -> bool:
    call = getattr(item, "callspec", None)
    return call is not None and call.params.get("engine") == "postgresql"


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    """The engine of the stores of the test: each in turn."""
    with used(request.param):
        yield request.param


@pytest.fixture
async def stage(tmp_path: Path) -> AsyncIterator[Stage]:
    async with staged(tmp_path) as built:
        yield built


@pytest.fixture
async def worker(stage: Stage) -> PlayedWorker:
    return await stage.worker()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """An empty one of the site."""
    with closing(open_store(tmp_path / "store.db")) as database:
        yield database
