"""What holds for every test: examples are the same in every run, and none has a time limit of its own.
The tests of whole sites come first: the many small ones fill the time in which the last of those wait."""

from __future__ import annotations

from collections.abc import Iterator
from types import CodeType

import pytest
from hypothesis import settings
from jinja2 import Environment

settings.register_profile("lineside", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("lineside")

WHOLE_SITES = {"e2e", "path"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With ``--no-loadscope-reorder``, xdist hands out files in this order."""
    items.sort(key=lambda item: item.path.parent.name not in WHOLE_SITES)


@pytest.fixture(scope="session", autouse=True)
def templates_compiled_once() -> Iterator[None]:
    """Hundreds of tests make an app of their own; to compile its templates is most of what each costs."""
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
