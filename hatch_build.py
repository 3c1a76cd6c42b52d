"""Build hook: checks the catalogs, and puts the browser's third-party files from the npm registry into the
git-ignored static/vendor.

A wheel carries them, with templates/ and static/, under app/_assets, so that installing one needs neither
Node nor a network. An sdist carries them too, so a wheel built from it needs no Node either.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from babel.messages.pofile import read_po
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

VENDORED = {
    "@fontsource-variable/inter/LICENSE": "licences/Inter.txt",
    "@fontsource-variable/inter/files/inter-latin-wght-normal.woff2": "inter.woff2",
    "htmx.org/dist/htmx.min.js": "htmx.min.js",
    "htmx.org/LICENSE": "licences/htmx.txt",
    "uplot/dist/uPlot.iife.min.js": "uPlot.iife.min.js",
    "uplot/dist/uPlot.min.css": "uPlot.min.css",
    "uplot/LICENSE": "licences/uPlot.txt",
}
"""What is taken out of node_modules, and its name in static/vendor."""

ASSETS = {"templates": "app/_assets/templates", "static": "app/_assets/static"}
"""Where the folders at the top of the repository stand in a wheel."""
CHAPTERS = ("*.md", "guide/*.md", "pictures/*.png")
"""What the help of the dashboard shows of docs/."""


class CustomBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Fills static/vendor before any build and puts templates and static files into a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        root = Path(self.root)
        if wrong := different_names(root / "app" / "core" / "messages"):
            sys.exit("A text and its translation have different names in braces:\n" + "\n".join(wrong))
        fill_vendor(root)
        if self.target_name == "wheel" and version == "standard":
            docs = root / "docs"
            chapters = [path for pattern in CHAPTERS for path in docs.glob(pattern)]
            build_data["force_include"].update(
                {str(root / here): there for here, there in ASSETS.items()}
                | {str(path): f"app/_assets/docs/{path.relative_to(docs).as_posix()}" for path in chapters}
            )


def different_names(folder: Path) -> list[str]:
    """Return catalog and English text of each translation that has other names in braces than its text."""
    found = []
    for path in sorted(folder.glob("*.po")):
        for message in read_po(BytesIO(path.read_bytes()), locale=path.stem):
            text, translation = _of_many(message.id), _of_many(message.string)
            if text and translation and _names(text) != _names(translation):
                found.append(f"{path.name}: {text}")
    return found


def _of_many(texts: str | Sequence[str]) -> str:
    """The text; of one that counts, the form for many, which is the last."""
    return texts if isinstance(texts, str) else texts[-1]


def _names(text: str) -> set[str]:
    return set(re.findall(r"\{(\w*)\}", text))


def fill_vendor(root: Path) -> None:
    """Install what package-lock.json says and copy it, unless static/vendor already is of that lock."""
    vendor = root / "static" / "vendor"
    mark = vendor / "made-from.sha256"
    wanted = _fingerprint(root)
    if mark.is_file() and mark.read_text() == wanted:
        return
    with tempfile.TemporaryDirectory() as work:
        packages = _install(root, Path(work))
        shutil.rmtree(vendor, ignore_errors=True)
        for source, name in VENDORED.items():
            (vendor / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(packages / source, vendor / name)
    mark.write_text(wanted)


def _fingerprint(root: Path) -> str:
    return hashlib.sha256((root / "package-lock.json").read_bytes() + repr(VENDORED).encode()).hexdigest()


def _install(root: Path, work: Path) -> Path:
    """Run npm away from the checkout, whose own node_modules also holds what the checks need."""
    npm = shutil.which("npm")
    if npm is None:
        sys.exit("There is no npm. Building from a checkout needs Node 18 or newer; a wheel needs none.")
    for name in ("package.json", "package-lock.json"):
        shutil.copyfile(root / name, work / name)
    subprocess.run(
        [npm, "ci", "--ignore-scripts", "--omit=dev", "--no-audit", "--no-fund"], cwd=work, check=True
    )
    return work / "node_modules"


if __name__ == "__main__":
    fill_vendor(Path(__file__).parent)
