"""The shape of the repository: layers, sizes, names, and what may not stand in it."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MEANINGLESS_NAMES = {"util", "utils", "helper", "helpers", "common", "misc", "manager", "managers"}
LEFT_BEHIND = re.compile(r"\b(TO[D]O|FIX[M]E|X{3})\b")
REGISTRY = re.compile(
    r'"resolved": *"http|index' r"-url|^registry *=|pypi\.org|files\.pythonhosted|registry\.npmjs", re.M
)


def tracked(*patterns: str) -> Iterator[Path]:
    """The files under version control that match one of the patterns (all when none is given)."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--", *patterns], cwd=ROOT, capture_output=True, check=True, text=True
    ).stdout
    return (path for name in listed.split("\0") if name and (path := ROOT / name).is_file())


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def relative(paths: Iterator[Path]) -> list[str]:
    return [str(path.relative_to(ROOT)) for path in paths]


def test_names_are_meaningful() -> None:
    vague = (path for path in tracked() if {path.stem, *path.relative_to(ROOT).parts} & MEANINGLESS_NAMES)
    assert relative(vague) == []


def test_nothing_is_left_for_later() -> None:
    code = tracked("*.py", "*.md", "*.html", "*.css", "*.js", "*.sql", "*.toml", "Makefile")
    assert relative(path for path in code if LEFT_BEHIND.search(text_of(path))) == []


def test_no_registry_is_named() -> None:
    own = Path(__file__).resolve()
    assert relative(path for path in tracked() if path != own and REGISTRY.search(text_of(path))) == []


def test_third_party_files_stay_out() -> None:
    foreign = re.compile(r"\.min\.(js|css)$|(^|/)(vendor|node_modules)/|(^|/)(uv|poetry|yarn)\.lock$")
    assert [name for name in relative(tracked()) if foreign.search(name)] == []


@pytest.mark.parametrize("suffix", ["html"])
def test_pages_hold_no_inline_script_or_style(suffix: str) -> None:
    """The content policy forbids both (ui.md), so a page that had one would be broken in the browser. A file
    that a person keeps is no page: it has its style in it.
    """
    inline = re.compile(
        r"<script(?![^>]*\bsrc=)[^>]*>|<style\b|\sstyle=|\son[a-z]+=|\bhx-on\b|javascript:", re.I
    )
    pages = tracked(f"templates/*.{suffix}")
    found = relative(path for path in pages if inline.search(text_of(path)))
    assert found == ["templates/handover/document.html", "templates/reports/document.html"]
