"""What exists is written down: every key of the configuration, every call of the API, every command."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer.main
from fastapi.routing import iter_route_contexts
from pydantic import BaseModel

from app.main import create_app
from app.settings import Settings
from tests.test_architecture import ROOT, text_of


def keys(model: type[BaseModel]) -> Iterator[str]:
    """Every key that a table of lineside.toml may hold, and the keys of the tables in it."""
    for name, field in model.model_fields.items():
        yield name
        for part in (field.annotation, *typing.get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from keys(part)


@pytest.mark.parametrize("key", sorted(set(keys(Settings))))
def test_every_key_of_the_configuration_is_documented(key: str) -> None:
    assert re.search(rf"[`\[.]{key}[`\].]", text_of(ROOT / "docs" / "configuration.md"))


def test_every_call_of_the_api_is_documented(tmp_path: Path) -> None:
    app = create_app(Settings.model_validate({"server": {"data": tmp_path}}))
    documented = set(re.findall(r"^\| `([A-Z]+) (/[^`?]*)", text_of(ROOT / "docs" / "api.md"), re.M))
    served = {
        (method, re.sub(r":\w+\}", "}", route.path.removeprefix("/api/v1")))
        for route in iter_route_contexts(app.routes)
        if route.path.startswith("/api/v1/")
        for method in (getattr(route, "methods", None) or ()) - {"HEAD", "OPTIONS"}
    }
    assert documented == served


def test_every_command_is_in_the_readme() -> None:
    from app.cli import cli

    commands = typer.main.get_command(cli).commands  # type: ignore[attr-defined]
    readme = text_of(ROOT / "README.md")
    assert [name for name in commands if f"lineside {name}" not in readme] == []
