"""What every app of the tests would make again is made once: compiled templates, the static files as they are
sent, and the description of the API. Both the process of the tests and that from which servers are forked use
it.
"""

from __future__ import annotations

import fcntl
import json
import marshal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from types import CodeType
from typing import Any, TypeVar

import fastapi
import jinja2
import pydantic
from jinja2 import Environment

from app.core.web import api
from app.core.web.assets import Assets, static_dir

ROOT = Path(__file__).parents[1]
TEMPLATES = ROOT / ".pytest_cache" / "templates"
DESCRIPTIONS = ROOT / ".pytest_cache" / "descriptions"
Kept = TypeVar("Kept", CodeType, str)


def compiling_once(folder: Path = TEMPLATES) -> Callable[..., CodeType]:
    """Return what stands for ``Environment.compile``. All processes share what they compile, in a folder that
    outlives them."""
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

    return compile_once


def kept_in(place: Path, making: Callable[[], Kept]) -> Kept:
    """What a file has, or else what is made, which it has then. What another process makes at this moment is
    worth waiting for."""
    with place.open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        # A process that was killed may have left a part.
        with suppress(EOFError, ValueError, TypeError):
            kept: Kept = marshal.loads(file.read())
            return kept
        made = making()
        file.truncate(0)
        file.write(marshal.dumps(made))
    return made


def reading_once() -> Callable[[Assets, Path], None]:
    """Return what stands for ``Assets.__init__``: to read and hash every static file is a quarter of what it
    takes to make an app, and each server packs them again."""
    read = Assets.__init__

    @cache
    def shared() -> dict[str, Any]:
        assets = Assets.__new__(Assets)
        read(assets, static_dir())
        return vars(assets)

    def init(assets: Assets, folder: Path) -> None:
        if folder == static_dir():
            vars(assets).update(shared())
        else:
            read(assets, folder)

    return init


def describing_once(folder: Path = DESCRIPTIONS) -> Callable[..., dict[str, Any]]:
    """Return what stands for FastAPI's ``get_openapi``, which takes a second. All processes share what it
    returns for these sources, in a folder that outlives them."""
    folder.mkdir(parents=True, exist_ok=True)
    describe = api.get_openapi

    @cache
    def sources() -> str:
        files = sorted(path for part in ("app", "bus") for path in (ROOT / part).rglob("*.py"))
        return repr([(str(path), path.stat().st_mtime_ns) for path in files])

    def describe_once(*, routes: Sequence[Any], **about: Any) -> dict[str, Any]:
        paths = [getattr(route, "path", "") for route in routes]
        made_of = repr((sources(), fastapi.__version__, pydantic.VERSION, paths, about))
        place = folder / sha256(made_of.encode()).hexdigest()
        text = kept_in(place, lambda: json.dumps(describe(routes=routes, **about)))
        described: dict[str, Any] = json.loads(text)
        return described

    return describe_once
