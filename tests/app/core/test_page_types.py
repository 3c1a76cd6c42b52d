"""What `types/page.d.ts` promises the scripts of a page, the templates hold: ids, and attributes of parts."""

from __future__ import annotations

import re
from itertools import chain

import pytest

from app.core.web.assets import static_dir, templates_dir

TYPES = (static_dir().parent / "types" / "page.d.ts").read_text(encoding="utf-8")
TEMPLATES = "\n".join(path.read_text(encoding="utf-8") for path in templates_dir().rglob("*.html"))
SCRIPTS = "\n".join(path.read_text(encoding="utf-8") for path in (static_dir() / "js").glob("*.js"))
ANY_TEXT = r"[\w-]+"


def _members(interface: str) -> list[str]:
    """The names that an interface declares, in each place where it does."""
    bodies = re.findall(rf"^interface {interface}\b[^{{]*\{{\n(.*?)^\}}", TYPES, re.MULTILINE | re.DOTALL)
    lines = chain.from_iterable(body.splitlines() for body in bodies)
    return [found[2] for line in lines if (found := re.match(r"""  (["']?)(.+?)\1: """, line))]


def _ids() -> re.Pattern[str]:
    """Any id that a template gives; what Jinja puts into one may be any word."""
    given = (re.split(r"\{\{.*?\}\}", name) for name in re.findall(r'\bid="([^"]+)"', TEMPLATES))
    return re.compile("|".join(ANY_TEXT.join(map(re.escape, parts)) for parts in given if any(parts)))


def _attributes(selector: str) -> list[str]:
    return re.findall(r"\[(data-[\w-]+)", selector)


@pytest.mark.parametrize("name", _members("PartsById"))
def test_a_template_has_the_part(name: str) -> None:
    assert _ids().fullmatch(name)


@pytest.mark.parametrize("selector", [*_members("Parts"), *_members("Kinds")])
def test_a_template_has_the_attributes_of_a_selector(selector: str) -> None:
    assert [name for name in _attributes(selector) if not re.search(rf"\b{name}\b", TEMPLATES)] == []
    assert f'"{selector}"' in SCRIPTS or f"'{selector}'" in SCRIPTS, "no script looks for it any more"


@pytest.mark.parametrize("name", _members("SoundParts"))
def test_a_template_has_the_part_of_the_sound(name: str) -> None:
    assert f"data-sound-{name}" in TEMPLATES


@pytest.mark.parametrize("name", [*_members("DOMStringMap"), *_members("TrendWords")])
def test_a_template_has_the_attribute(name: str) -> None:
    attribute = "data-" + re.sub(r"[A-Z]", lambda upper: f"-{upper[0].lower()}", name)
    assert re.search(rf"\b{attribute}\b", TEMPLATES)


def test_the_promises_are_found() -> None:
    assert (
        min(len(_members(name)) for name in ("Parts", "PartsById", "Kinds", "SoundParts", "DOMStringMap")) > 5
    )
