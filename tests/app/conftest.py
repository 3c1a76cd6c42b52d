"""The app that a test uses, complete or up to the commands, and its worker."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from app.core.database import Database
from app.line.history.service import History
from bus.contract import Reading, Update
from tests.app.complete_app import House, commands_app, complete_app
from tests.app.fake_worker import PlayedWorker


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """The complete app, with two units that have not responded yet."""
    async with complete_app(tmp_path) as house:
        yield house


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[House]:
    """The features up to the commands, with three units."""
    async with commands_app(tmp_path) as house:
        yield house


@pytest.fixture
async def worker(site: House) -> PlayedWorker:
    """The worker of ``site``, which does nothing until the test sets its play."""
    return await site.worker()


class Kept(list[Update]):
    """What the history of an app was given."""

    @property
    def readings(self) -> list[Reading]:
        return [update for update in self if isinstance(update, Reading)]


@pytest.fixture
def kept(site: House, monkeypatch: pytest.MonkeyPatch) -> Kept:
    kept = Kept()
    monkeypatch.setattr(site.services[History], "append", lambda _bus, updates: kept.extend(updates))
    return kept


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """An empty one of the site."""
    with closing(Database(tmp_path / "store.db")) as database:
        yield database
