"""The stage that many tests use, and its worker, which does nothing until the test sets its play."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from app.core.database import Database
from tests.app.stage import PlayedWorker, Stage, staged


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
    with closing(Database(tmp_path / "store.db")) as database:
        yield database
