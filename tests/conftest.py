"""Settings for every test: examples are the same in every run, and no test sets a time limit. The tests of
complete sites come first: the many small ones fill the time in which the last of those wait.
"""

from __future__ import annotations

import fcntl
import gc
import marshal
import os
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial, wraps
from hashlib import sha256
from pathlib import Path
from types import CodeType
from typing import Any

import certifi
import jinja2
import pytest
import structlog
from argon2 import PasswordHasher
from hypothesis import settings
from jinja2 import Environment

import app.core.database.database
import app.core.messages.languages
import app.people.auth.passwords
from app.core.database.files import Reserve
from app.core.database.migration import MIGRATIONS, Migration, bring_up_to_date
from app.core.web.assets import Assets, static_dir

settings.register_profile("lineside", derandomize=True, deadline=None, max_examples=30)
# In `make soak`: other examples in each run, and many.
settings.register_profile("soak", deadline=None, max_examples=1000)
settings.load_profile("lineside")

pytest_plugins = ["tests.processes"]

COMPLETE_SITES = {"e2e", "path"}
HISTORY_MIGRATIONS = MIGRATIONS.parents[1] / "history" / "migrations"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The order of files in which the processes take them."""
    items.sort(key=lambda item: item.path.parent.name not in COMPLETE_SITES)


# With the values of every frame, one traceback in a log takes two seconds.
structlog.dev.ConsoleRenderer.get_active().exception_formatter = structlog.dev.plain_traceback
# httpx looks for it with every request to an app of this process; it is not installed, and not needed.
sys.modules.setdefault("sniffio", None)  # type: ignore[arg-type]
# Nothing that is collected or imported for it is garbage, then or in a test.
gc.disable()


def pytest_collection_finish() -> None:
    """Keep the garbage collector from visiting it in each test."""
    gc.collect()
    gc.freeze()
    gc.enable()


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
def templates_compiled_once(pytestconfig: pytest.Config) -> Iterator[None]:
    """Hundreds of tests make an app; compiling its templates is most of the cost of each. All processes share
    what they compile, in a folder that outlives them."""
    folder = pytestconfig.rootpath / ".pytest_cache" / "templates"
    folder.mkdir(parents=True, exist_ok=True)
    compile_template = Environment.compile
    compiled: dict[tuple[str, str | None, str | None], CodeType] = {}

    def compile_once(
        environment: Environment, source: str, name: str | None = None, filename: str | None = None
    ) -> CodeType:
        key = source, name, filename
        if key not in compiled:
            made_of = repr((*key, jinja2.__version__, sys.implementation.cache_tag))
            place = folder / sha256(made_of.encode()).hexdigest()
            compiled[key] = kept_in(place, partial(compile_template, environment, *key))
        return compiled[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Environment, "compile", compile_once)
        yield


def kept_in(place: Path, compiling: Callable[[], CodeType]) -> CodeType:
    """What a file has, or else what is compiled, which it has then. What another process compiles at this
    moment is worth waiting for."""
    with place.open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        # A process that was killed may have left a part.
        with suppress(EOFError, ValueError, TypeError):
            code: CodeType = marshal.loads(file.read())
            return code
        code = compiling()
        file.truncate(0)
        file.write(marshal.dumps(code))
    return code


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
    models = {folder: model_of(folder) for folder in (MIGRATIONS, HISTORY_MIGRATIONS)}
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
    return model, bring_up_to_date(model, Path("model"), folder)


@pytest.fixture(scope="session", autouse=True)
def assets_read_once() -> Iterator[None]:
    """To read and hash every static file is a quarter of what it takes to make an app."""
    read = Assets.__init__

    @cache
    def shared() -> dict[str, Any]:
        assets = Assets.__new__(Assets)
        read(assets, static_dir())
        return vars(assets)

    def init(self: Assets, folder: Path) -> None:
        if folder == static_dir():
            vars(self).update(shared())
        else:
            read(self, folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Assets, "__init__", init)
        yield


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
            app.people.auth.passwords,
            "_hasher",
            PasswordHasher(time_cost=1, memory_cost=8, parallelism=1),
        )
        yield
