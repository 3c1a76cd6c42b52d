"""What every app of the tests would make again is made once: compiled templates, and the static files as they
are sent. Both the process of the tests and that from which servers are forked use it.
"""

from __future__ import annotations

import fcntl
import marshal
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from types import CodeType
from typing import Any

import jinja2
from jinja2 import Environment

from app.core.web.assets import Assets, static_dir

TEMPLATES = Path(__file__).parents[1] / ".pytest_cache" / "templates"


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
