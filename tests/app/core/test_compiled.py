"""Compiled templates outlive the process, follow their source, and are no more than a help."""

from __future__ import annotations

from pathlib import Path

from jinja2 import DictLoader, Environment

from app.core.web.templating import Compiled


def rendered(source: str, folder: Path) -> str:
    """As a process just started renders it."""
    loader = DictLoader({"page.html": source})
    return Environment(loader=loader, bytecode_cache=Compiled(folder)).get_template("page.html").render()


def test_stored_templates_are_used(tmp_path: Path) -> None:
    assert rendered("one", tmp_path / "kept") == "one"
    (kept,) = (tmp_path / "kept").iterdir()
    kept.write_bytes(kept.read_bytes().replace(b"one", b"two"))
    assert rendered("one", tmp_path / "kept") == "two"


def test_a_changed_source_is_compiled_again(tmp_path: Path) -> None:
    assert rendered("one", tmp_path) == "one"
    assert rendered("two", tmp_path) == "two"


def test_a_broken_file_and_a_folder_that_cannot_be_written_do_no_harm(tmp_path: Path) -> None:
    rendered("one", tmp_path)
    for kept in tmp_path.iterdir():
        kept.write_bytes(kept.read_bytes()[:-5])
    assert rendered("one", tmp_path) == "one"
    (tmp_path / "file").write_text("")
    assert rendered("one", tmp_path / "file") == "one"
