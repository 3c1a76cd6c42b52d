"""A wheel carries everything that the browser is served, so it runs without Node and without a network."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from app.core.help.handbook import CHAPTERS, Chapter
from tests.test_architecture import ROOT, tracked


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [Path(sys.executable).with_name("hatchling"), "build", "-t", "wheel", "-d", folder],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    [built] = folder.glob("lineside-*.whl")
    return built


def test_it_holds_every_template_static_file_and_chapter(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    wanted = {f"app/_assets/{path.relative_to(ROOT)}" for path in tracked("templates", "static")}
    chapters = {f"app/_assets/docs/{name}" for chapter in CHAPTERS for name in files_of(chapter)}
    assert (wanted | chapters) - held == set()


def files_of(chapter: Chapter) -> set[str]:
    return {chapter.file_in(language) for language in ("en", *chapter.languages)}


def test_it_holds_third_party_files_with_their_licences(wheel: Path) -> None:
    vendor = "app/_assets/static/vendor/"
    held = {
        name.removeprefix(vendor) for name in zipfile.ZipFile(wheel).namelist() if name.startswith(vendor)
    }
    assert {"htmx.min.js", "inter.woff2", "uPlot.iife.min.js", "uPlot.min.css"} < held
    assert {"licences/Inter.txt", "licences/htmx.txt", "licences/uPlot.txt"} < held


def test_it_holds_nothing_that_is_only_for_development(wheel: Path) -> None:
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top for top in tops if not top.startswith("lineside-")} == {"app", "bus"}


def test_unpacked_elsewhere_it_finds_its_own_files(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    program = (
        "from app.core.web.assets import static_dir, templates_dir;"
        "print(static_dir()); print(templates_dir())"
    )
    folders = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "PATH": "/nowhere"},
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    assert [Path(folder).relative_to(tmp_path) for folder in folders] == [
        Path("app/_assets/static"),
        Path("app/_assets/templates"),
    ]


def test_node_18_of_debian_12_suffices_to_build() -> None:
    """Of what is installed for `make demo`; what the checks need is newer."""
    locked = json.loads((ROOT / "package-lock.json").read_text())
    built = {name: each for name, each in locked["packages"].items() if name and not each.get("dev")}
    assert {name.removeprefix("node_modules/") for name in built} == {
        "@fontsource-variable/inter",
        "htmx.org",
        "uplot",
    }
    needed = [each.get("engines", {}).get("node", ">=0") for each in built.values()]
    assert all(int(number) <= 18 for version in needed for number in re.findall(r"\d+", version)[:1])
    assert locked["lockfileVersion"] <= 3, "which npm 9 reads"
