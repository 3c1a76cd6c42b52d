"""Every text of the screen is there in every language, with the same names in braces."""

from __future__ import annotations

import ast
import re
import string
from pathlib import Path

import pytest

from app.live.fields import STATE_WORDS
from app.live.hub import STAGE_WORDS
from app.web.access import Role
from app.web.assets import templates_dir
from app.web.languages import Languages
from bus.catalogue.parameters import PARAMETERS
from bus.errors import UnitErrorCode, unit_error_name

APP = Path(__file__).resolve().parents[2] / "app"
COMMENT = re.compile(r"\{#.*?#\}", re.DOTALL)
CALL = re.compile(r"""(?<![\w.])t\(\s*(?:"((?:[^"\\]|\\.)*)"|'((?:[^'\\]|\\.)*)')""")
FILLED = "X1"
OTHERS = [tag.tag for tag in Languages() if tag.tag != "en"]


def in_templates() -> set[str]:
    found = set()
    for path in templates_dir().rglob("*.html"):
        for match in CALL.finditer(COMMENT.sub("", path.read_text(encoding="utf-8"))):
            found.add(match[1] if match[1] is not None else match[2])
    return found


def in_code() -> set[str]:
    found = set()
    for path in APP.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "t" and node.args:
                text = node.args[0]
                if isinstance(text, ast.Constant) and isinstance(text.value, str):
                    found.add(text.value)
    return found


def in_tables() -> set[str]:
    parameters = PARAMETERS.values()
    return {
        *STATE_WORDS.values(),
        *STAGE_WORDS.values(),
        *(unit_error_name(code) for code in UnitErrorCode),
        *(parameter.meaning for parameter in parameters),
        *(parameter.group for parameter in parameters),
        *(parameter.dangerous for parameter in parameters if parameter.dangerous),
        *(word for parameter in parameters for word in parameter.choices.values()),
        *(str(role) for role in Role),
    }


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


def sentence(node: ast.JoinedStr) -> str:
    return "".join(str(part.value) if isinstance(part, ast.Constant) else FILLED for part in node.values)


def names(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name}


@pytest.mark.parametrize("tag", OTHERS)
def test_every_text_is_translated(tag: str) -> None:
    texts = Languages()[tag].texts
    missing = sorted((in_templates() | in_code() | in_tables()) - texts.keys())
    assert missing == []


@pytest.mark.parametrize("tag", OTHERS)
def test_a_translation_has_the_names_of_its_text(tag: str) -> None:
    texts = Languages()[tag].texts
    assert {text: said for text, said in texts.items() if names(text) != names(said)} == {}


@pytest.mark.parametrize("tag", OTHERS)
def test_every_sentence_that_is_raised_is_found_by_its_pattern(tag: str) -> None:
    language = Languages()[tag]
    assert sorted(text for text in built() if language.t(text) == text) == []


def test_the_search_finds_texts_at_all() -> None:
    assert "Set line to zero" in in_templates()
    assert "verified" in in_code()
    assert f"set {FILLED} does not hold unit {FILLED}" in built()
