"""Every text that people read: screen, messages, command line, API, logs, documentation."""

from __future__ import annotations

import ast
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from app.cli import cli
from app.main import create_app
from app.messages.languages import DEFAULT, catalogs
from app.settings import Settings
from app.web.api.schema import openapi_document
from tests.catalogs import catalog_at, wanted
from tests.vocabulary import ROOT

LOG_CALLS = {"debug", "info", "warning", "error", "exception"}
DESCRIBED = ("description", "summary")
DOCUMENTS = [
    *ROOT.glob("*.md"),
    *(path for path in (ROOT / "docs").rglob("*.md") if path.name != "glossary.md"),
]
CODE_IN_TEXT = re.compile(r"```.*?```|`[^`\n]*`|https?://\S+|\]\([^)]*\)", re.DOTALL)


def screen() -> Iterator[tuple[str, str]]:
    """Each English text of a page and of a message."""
    for (code, _), text in wanted().items():
        yield from ((code or "page", each) for each in ((text,) if isinstance(text, str) else text))


def translations(tag: str) -> Iterator[tuple[str, str]]:
    """Each text of a catalog in its language, with its English."""
    for message in catalog_at(catalogs()[tag]):
        if message.id and tag != DEFAULT:
            many = message.string if isinstance(message.string, list | tuple) else [message.string]
            yield from ((str(message.id), each) for each in many)


def command_line() -> Iterator[tuple[str, str]]:
    """The help of each command and of each of its options."""
    yield from _helps("lineside", cli)


def _helps(path: str, command: Any) -> Iterator[tuple[str, str]]:
    yield path, command.help or ""
    yield from ((f"{path} {option.name}", getattr(option, "help", None) or "") for option in command.params)
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        yield from _helps(f"{path} {name}", command.get_command(None, name))


def api() -> Iterator[tuple[str, str]]:
    """Each description of the API's document."""
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings.model_validate({"server": {"data": Path(folder)}}))
        yield from _described("", openapi_document(app))


def _described(path: str, node: Any) -> Iterator[tuple[str, str]]:
    if isinstance(node, dict):
        for key, each in node.items():
            if key in DESCRIBED and isinstance(each, str):
                yield f"{path}/{key}", CODE_IN_TEXT.sub("", each)
            yield from _described(f"{path}/{key}", each)
    elif isinstance(node, list):
        for each in node:
            yield from _described(path, each)


def logs() -> Iterator[tuple[str, str]]:
    """The fixed text of each call of a logger."""
    for path in sorted(path for part in ("app", "bus") for path in (ROOT / part).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(func=ast.Attribute(attr=name), args=[ast.Constant(value=str(text)), *_]) if (
                    name in LOG_CALLS
                ):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", text


def documents() -> Iterator[tuple[str, str]]:
    """Each line of the documentation, without what it quotes as code."""
    for path in DOCUMENTS:
        prose = CODE_IN_TEXT.sub(
            lambda code: "\n" * code.group().count("\n"), path.read_text(encoding="utf-8")
        )
        for number, line in enumerate(prose.splitlines(), start=1):
            yield f"{path.relative_to(ROOT)}:{number}", line
