"""Settings for every test: examples are the same in every run, and no test sets a time limit. The tests of
complete sites come first: the many small ones fill the time in which the last of those wait.
"""

from __future__ import annotations

import gc
import sqlite3
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType

import pytest
from argon2 import PasswordHasher
from hypothesis import settings
from jinja2 import Environment

import app.auth.passwords
import app.database.connection
import app.messages.language
from app.database.migrating import MIGRATIONS, Migration, bring_up_to_date
from app.web.assets import Assets

settings.register_profile("lineside", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("lineside")

COMPLETE_SITES = {"e2e", "path"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the order of files in which xdist distributes them, with ``--no-loadscope-reorder``."""
    items.sort(key=lambda item: item.path.parent.name not in COMPLETE_SITES)


def pytest_collection_finish() -> None:
    """What thousands of test functions hold stays: the garbage collector need not visit it in each test."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def templates_compiled_once() -> Iterator[None]:
    """Hundreds of tests make an app; compiling its templates is most of the cost of each."""
    compile_template = Environment.compile
    compiled: dict[tuple[str, str | None, str | None], CodeType] = {}

    def compile_once(
        environment: Environment, source: str, name: str | None = None, filename: str | None = None
    ) -> CodeType:
        key = source, name, filename
        if key not in compiled:
            compiled[key] = compile_template(environment, source, name, filename)
        return compiled[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Environment, "compile", compile_once)
        yield


@pytest.fixture(scope="session", autouse=True)
def catalogs_compiled_once() -> Iterator[None]:
    """Every app has a folder for them, in which the first page in German would compile its catalog again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app.messages.language, "_parsed", cache(app.messages.language._parsed))
        yield


@pytest.fixture(scope="session", autouse=True)
def stores_made_once() -> Iterator[None]:
    """A new store is a copy of one that has taken all its steps, each of which waits for the disk."""
    model = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    taken = bring_up_to_date(model, Path("model"), MIGRATIONS)

    def copy_if_new(connection: sqlite3.Connection, path: Path, folder: Path) -> list[Migration]:
        is_new = connection.execute("SELECT 1 FROM sqlite_master").fetchone() is None
        if not is_new or folder != MIGRATIONS:
            return bring_up_to_date(connection, path, folder)
        model.backup(connection)
        return taken

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app.database.connection, "bring_up_to_date", copy_if_new)
        yield
    model.close()


@pytest.fixture(scope="session", autouse=True)
def assets_read_once() -> Iterator[None]:
    """To read and hash every static file is a quarter of what it takes to make an app. Tests that make none
    have not imported what makes it, which takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        if wiring := sys.modules.get("app.wiring"):
            patch.setattr(wiring, "Assets", cache(Assets))
        yield


@pytest.fixture(scope="session", autouse=True)
def passwords_hashed_cheaply() -> Iterator[None]:
    """A hash in this process takes 0.1 ms instead of 28: hundreds of tests sign a user in. The servers
    that tests start hash as they do everywhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            app.auth.passwords, "_hasher", PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
        )
        yield
