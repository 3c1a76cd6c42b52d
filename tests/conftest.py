"""Settings for every test: examples are the same in every run, and no test sets a time limit."""

from __future__ import annotations

import gc
import os
import sqlite3
import sys
from collections.abc import Iterator
from functools import cache, partial, wraps
from pathlib import Path
from shutil import disk_usage
from typing import Any

import certifi
import pytest
import structlog
from argon2 import PasswordHasher
from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import text
from jinja2 import Environment

import app.core.database.database
import app.core.messages.languages
import app.core.web.api
import app.people.auth.passwords
from app.core.database.files import Reserve
from app.core.database.migration import MIGRATIONS, Migration, bring_up_to_date
from app.core.web.assets import Assets
from tests.made_once import compiling_once, describing_once, reading_once

# A busy machine is no fault of an example.
settings.register_profile(
    "lineside",
    derandomize=True,
    deadline=None,
    max_examples=20,
    stateful_step_count=25,
    suppress_health_check=[HealthCheck.too_slow],
)
# In `make soak`: other examples in each run, and many.
settings.register_profile("soak", deadline=None, max_examples=1000)
settings.load_profile("lineside")

pytest_plugins = ["tests.processes"]

APP = MIGRATIONS.parents[2]
STORES = (MIGRATIONS, APP / "line" / "history" / "migrations", APP / "records" / "handover" / "migrations")


MEMORY = Path("/dev/shm")
NEEDED_BYTES = 6_000_000_000


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Put the folders of tests in memory where there is room, and keep those of failed tests only: to make
    and delete their files on a disk is a tenth of what an app costs."""
    if config.option.basetemp or "PYTEST_DEBUG_TEMPROOT" in os.environ or not os.access(MEMORY, os.W_OK):
        return
    if disk_usage(MEMORY).free > NEEDED_BYTES and not os.statvfs(MEMORY).f_flag & os.ST_NOEXEC:
        os.environ["PYTEST_DEBUG_TEMPROOT"] = str(MEMORY)


# With the values of every frame, one traceback in a log takes two seconds.
structlog.dev.ConsoleRenderer.get_active().exception_formatter = structlog.dev.plain_traceback
# httpx looks for it with every request to an app of this process; it is not installed, and not needed.
sys.modules.setdefault("sniffio", None)  # type: ignore[arg-type]
# Nothing that is collected or imported for it is garbage, then or in a test.
gc.disable()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Keep the garbage collector from visiting it in each test."""
    if sum(session.config.getoption("processes")) > 1 and not session.config.option.collectonly:
        draw_once()
    gc.collect()
    gc.freeze()
    # To look often for what tests leave behind takes a thirtieth of their time.
    gc.set_threshold(10_000, 20, 20)
    gc.enable()


@settings(max_examples=1, database=None)
@given(text())
def draw_once(_: str) -> None:
    """Have Hypothesis read Unicode's tables and the constants of the program, which takes two seconds: once,
    and not in each of the processes that are forked from this one."""


@pytest.fixture(scope="session", autouse=True)
def one_authority(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Loading all those of the web takes longer than a call, and httpx does it for every client. None of them
    signed what a test serves."""
    first, end, _ = Path(certifi.where()).read_text("utf-8").partition("-----END CERTIFICATE-----\n")
    file = tmp_path_factory.mktemp("authority") / "first.pem"
    file.write_text(first + end, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(certifi, "where", lambda: str(file))
        yield


@pytest.fixture(scope="session", autouse=True)
def made_once() -> Iterator[None]:
    """Hundreds of tests make an app."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Environment, "compile", compiling_once())
        patch.setattr(Assets, "__init__", reading_once())
        patch.setattr(app.core.web.api, "get_openapi", describing_once())
        yield


@pytest.fixture(scope="session", autouse=True)
def catalogs_compiled_once() -> Iterator[None]:
    """Every app has a folder for them, in which the first page in German would compile its catalog again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app.core.messages.languages, "_parsed", cache(app.core.messages.languages._parsed))
        yield


@pytest.fixture(scope="session", autouse=True)
def stores_made_once() -> Iterator[None]:
    """A new store is a copy of one that has taken all its steps, and none waits for the disk: no test of this
    process ends its power supply. The processes that tests start and kill write as they do everywhere."""
    models = {folder: model_of(folder) for folder in STORES}
    open_for_writing = app.core.database.database.open_for_writing

    def copy_if_new(connection: sqlite3.Connection, path: Path, folder: Path) -> list[Migration]:
        is_new = connection.execute("SELECT 1 FROM sqlite_master").fetchone() is None
        if not is_new or folder not in models:
            return bring_up_to_date(connection, path, folder)
        model, taken = models[folder]
        model.backup(connection)
        return taken

    @wraps(open_for_writing)
    def open_without_waiting(*place: Any, **options: Any) -> sqlite3.Connection:
        connection = open_for_writing(*place, **options)
        connection.execute("PRAGMA synchronous = OFF")
        return connection

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app.core.database.database, "bring_up_to_date", copy_if_new)
        patch.setattr(app.core.database.database, "open_for_writing", open_without_waiting)
        patch.setattr(os, "fsync", lambda _: None)
        yield
    for model, _ in models.values():
        model.close()


def model_of(folder: Path) -> tuple[sqlite3.Connection, list[Migration]]:
    """A store in memory that has taken the steps of a folder, and these steps."""
    model = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    model.execute("PRAGMA auto_vacuum = INCREMENTAL")
    taken = bring_up_to_date(model, Path("model"), folder)
    assert taken, folder
    return model, taken


@pytest.fixture(scope="session", autouse=True)
def reserves_are_small() -> Iterator[None]:
    """What a test leaves behind is kept for a while, and many make an app that they never end."""
    with pytest.MonkeyPatch.context() as patch:
        if feature := sys.modules.get("app.core.database.feature"):
            patch.setattr(feature, "Reserve", partial(Reserve, size=1_000_000))
        yield


@pytest.fixture(scope="session", autouse=True)
def passwords_hashed_cheaply() -> Iterator[None]:
    """A hash in this process takes 0.1 ms instead of 28: hundreds of tests sign a user in. The servers
    that tests start hash as they do everywhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            app.people.auth.passwords, "_hasher", PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
        )
        yield
