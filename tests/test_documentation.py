"""What exists is written down: every key of the configuration, every call of the API, every command."""

from __future__ import annotations

import re
import tomllib
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from fastapi.routing import iter_route_contexts
from pydantic import BaseModel

from app.cli import cli
from app.main import create_app
from app.settings import Settings
from docs import generated
from tests.test_architecture import ROOT, text_of

COMMAND: Any = cli


def keys(model: type[BaseModel]) -> Iterator[str]:
    """Every key that a table of lineside.toml may hold, and the keys of the tables in it."""
    for name, field in model.model_fields.items():
        yield field.alias or name
        for part in (field.annotation, *typing.get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from keys(part)


@pytest.mark.parametrize("key", sorted(set(keys(Settings))))
def test_every_key_of_the_configuration_is_documented(key: str) -> None:
    assert re.search(rf"[`\[.]{key}[`\].]", text_of(ROOT / "docs" / "configuration.md"))


def examples() -> Iterator[tuple[str, str]]:
    """Each example of ``lineside.toml``: its place, and the TOML."""
    for path in sorted((ROOT / "docs").rglob("*.md")):
        for number, example in enumerate(re.findall(r"```toml\n(.*?)```", text_of(path), re.S)):
            yield f"{path.name}-{number}", example


@pytest.mark.parametrize("example", [pytest.param(text, id=place) for place, text in examples()])
def test_every_example_of_the_configuration_is_valid(example: str) -> None:
    """With what an example leaves out: a bus with its port, and the units that it names."""
    written = tomllib.loads(example)
    bus = written.get("bus", [{"name": "dry-end"}])[0]
    units = {number: {"id": number, "name": f"Unit {number}"} for number in range(1, 5)}
    units |= {unit["id"]: unit for unit in bus.get("unit", ())}
    complete = {"port": "/dev/ttyUSB0", **bus, "unit": list(units.values())}
    Settings.model_validate({**written, "bus": [complete, *written.get("bus", ())[1:]]})


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
    readme = text_of(ROOT / "README.md")
    commands = COMMAND.list_commands(None)
    assert len(commands) > 10
    assert [name for name in commands if f"lineside {name}" not in readme] == []


@pytest.mark.parametrize("path", generated.CHAPTERS, ids=lambda path: path.name)
def test_a_chapter_from_the_code_is_as_the_code(path: Path) -> None:
    """After a change: ``python -m docs.generated``."""
    assert generated.CHAPTERS[path]() == text_of(path)


def test_every_link_to_a_file_leads_to_one() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)#\s:]+)[)#]", text_of(page))]
    assert len(links) > 20
    assert [f"{page.name}: {link}" for page, link in links if not (page.parent / link).exists()] == []


def places_of_changes() -> dict[str, list[str]]:
    """The table of CONTRIBUTING: each frequent change, and the paths to open for it."""
    table = text_of(ROOT / "CONTRIBUTING.md").partition("| to change | see |")[2].partition("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    return {change: re.findall(r"`([\w./-]+/[\w./-]+)`", places) for change, places in rows}


@pytest.mark.parametrize(("change", "paths"), places_of_changes().items())
def test_each_frequent_change_takes_at_most_two_files(change: str, paths: list[str]) -> None:
    assert 1 <= len(paths) <= 2, change
    assert [path for path in paths if not (ROOT / path).is_file()] == []


def test_ten_changes_have_their_place_in_the_table() -> None:
    assert len(places_of_changes()) >= 10


def documented_calls() -> Iterator[tuple[str, list[str]]]:
    """Each ``lineside`` command line of the documentation: the file, and its words."""
    folder = ROOT / "docs"
    for path in (ROOT / "README.md", *sorted(folder.glob("*.md")), *sorted(folder.glob("guide/*.md"))):
        text = text_of(path)
        blocks = re.findall(r"```sh\n(.*?)```", text, re.S)
        lines = [line.partition("#")[0] for block in blocks for line in block.splitlines()]
        spans = [
            " ".join(span.split())
            for span in re.findall(r"`([^`]+)`", re.sub(r"```.*?```", "", text, flags=re.S))
        ]
        for line in lines + spans:
            if match := re.match(r"(?:sudo (?:-u \w+ )?)?(?:/\S+/)?lineside (.+)", line):
                yield path.name, match[1].split()


@pytest.mark.parametrize(
    ("source", "words"), [pytest.param(*each, id=" ".join(each[1])) for each in documented_calls()]
)
def test_every_documented_command_line_is_one(source: str, words: list[str]) -> None:
    command = COMMAND
    while words and hasattr(command, "get_command"):
        name, *words = words
        if name.startswith("-"):
            break
        _, command, _ = command.resolve_command(click.Context(command), [name])
        assert command is not None, source
    options = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    assert {word for word in words if word.startswith("--")} <= options, source
