"""Every sentence that is built in English is found by a pattern of every language."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from app.audit.kinds import EventKind
from app.messages import Languages
from tests.catalogs import wanted

APP = Path(__file__).resolve().parents[2] / "app"
BUS = APP.parent / "bus"
FILLED = "X1"
SQL = re.compile(r"\s*(SELECT|INSERT|UPDATE|DELETE|CREATE|PRAGMA|WITH|ALTER|DROP|FROM|WHERE|AND|ORDER|JOIN) ")
FOR_PROGRAMS = (
    *("app/cli", "app/metrics", "app/settings.py", "bus/messages", "app/web/schema"),
    "app/commands/api/responses.py",
    *("app/audit/walk.py", "app/audit/key_file.py", "app/audit/keys.py", "app/audit/anchor.py"),
    "app/database/private.py",
    "app/history/series/columns.py",
    "app/history/export/rows.py",
    *("app/feed/ingest.py", "app/feed/socket.py", "bus/configuration.py", "bus/settings.py"),
    *(
        "app/server",
        "bus/simulator",
        "bus/wire",
        "bus/worker/uplink.py",
        "bus/__main__.py",
        "app/web/routes.py",
    ),
)
"""What is said on a console, in a log or between our own programs; no page shows it."""
UNSEEN_CALLS = {
    "info",
    "warning",
    "error",
    "exception",
    "Query",
    "Path",
    "Body",
    "Field",
    "create_task",
    "begin",
}
UNSEEN_KEYWORDS = {"description", "summary", "title", "help", "name"}
PARTS = {}
"""Pieces of a sentence → one that is built of them."""
UNSEEN = {
    "X1 (X1 of unit key X1 from X1)": "a log",
    "of a size that cannot be known now": "has a pattern of its own",
    "a worker says hello first": "said to a program",
    "this bus was connected to too often; wait a minute": "said to a program",
    'Bearer error="invalid_token", error_description="The access token expired"': "a header",
    'it must be a JSON object, {"…": …}, sent as Content-Type: application/json': "said to a program",
}
"""Sentences that no page shows as they stand, and why."""
OTHERS = [tag.tag for tag in Languages() if tag.tag != "en"]


def built() -> set[str]:
    """Sentences that pages show and that are built where they are raised, with something in each brace."""
    found = set()
    for part in ("auth", "commands", "recipes", "sets", "swap"):
        for path in (APP / part).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Raise) and node.exc is not None:
                    found |= {
                        sentence(each) for each in ast.walk(node.exc) if isinstance(each, ast.JoinedStr)
                    }
    return {text for text in found if re.search("[a-z]{2,} [a-z]", text)}


def spoken() -> dict[str, str]:
    """Every sentence of four words and more in a file whose words a page may show → the file."""
    found = {}
    for path in [*APP.rglob("*.py"), *BUS.rglob("*.py")]:
        name = path.relative_to(APP.parent).as_posix()
        if not name.startswith(FOR_PROGRAMS):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            unseen = {id(each) for part in unseen_parts(tree) for each in ast.walk(part)}
            for node in ast.walk(tree):
                if id(node) not in unseen:
                    found[text_of(node)] = name
    return {
        text: name
        for text, name in found.items()
        if len(text.split()) > 3 and re.search("[a-z]{2,} [a-z]", text) and not SQL.match(text)
    }


def left_as_it_is(text: str, said: str) -> list[str]:
    """The clauses that stand in both: a general pattern says what it joins one by one."""
    clauses = re.split("[;:] ", text)
    return [each for each in clauses if each in said and re.search("[a-z]{2,} [a-z]{2,}", each)]


def unseen_parts(tree: ast.AST) -> Iterator[ast.AST]:
    """Docstrings, what is logged or described to programs, and the pieces of a sentence with braces."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant()):
                yield node
            case ast.JoinedStr():
                yield from node.values
            case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name)) if name in UNSEEN_CALLS:
                yield from node.args
                yield from node.keywords
            case ast.keyword(arg=name) if name in UNSEEN_KEYWORDS:
                yield node.value


def text_of(node: ast.AST) -> str:
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr():
            return sentence(node)
    return ""


def noted() -> set[str]:
    """What is written into the events in fixed words."""
    found = set()
    for path in APP.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Attribute(attr="record" | "_record") | ast.Name(id="Wording" | "Change")
                ):
                    given = [*node.args, *(one.value for one in node.keywords)]
                    found |= {text_of(each) for each in given if isinstance(each, ast.Constant)}
    return found - {""} - set(get_args(EventKind))


def sentence(node: ast.JoinedStr) -> str:
    return "".join(str(part.value) if isinstance(part, ast.Constant) else FILLED for part in node.values)


@pytest.mark.parametrize("tag", OTHERS)
def test_every_sentence_that_is_raised_is_found_by_its_pattern(tag: str) -> None:
    language = Languages()[tag]
    assert sorted(text for text in built() if language.t(text) == text) == []


@pytest.mark.parametrize("tag", OTHERS)
def test_every_sentence_in_the_code_is_translated(tag: str) -> None:
    language = Languages()[tag]
    counted = {text for pair in wanted().values() if isinstance(pair, tuple) for text in pair}
    untold = {text: name for text, name in spoken().items() if left_as_it_is(text, language.t(text))}
    untold = {text: name for text, name in untold.items() if text not in counted}
    assert {text: name for text, name in untold.items() if text not in PARTS.keys() | UNSEEN.keys()} == {}


@pytest.mark.parametrize("tag", OTHERS)
@pytest.mark.parametrize("whole", PARTS.values())
def test_what_is_built_of_pieces_is_translated_whole(tag: str, whole: str) -> None:
    said = Languages()[tag].t(whole)
    assert said != whole
    assert not set(re.findall("[a-z]+", said.lower())) & {"the", "of", "unit"}


@pytest.mark.parametrize("tag", OTHERS)
def test_every_word_of_the_events_is_translated(tag: str) -> None:
    language = Languages()[tag]
    assert sorted(text for text in noted() if language.t(text) == text) == []


def test_the_search_finds_texts_at_all() -> None:
    assert "before the first write of the day" in spoken()
