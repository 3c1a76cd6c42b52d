"""A configuration file with comments, as a plant has it, the app with it, and the forms of its pages."""

from __future__ import annotations

import re
import stat
from collections.abc import AsyncIterator
from dataclasses import dataclass
from html import unescape
from pathlib import Path

import httpx

from tests.app.complete_app import House, complete_app

UNIT = "/configuration/tables/bus.0.unit.0"
"""The page of the first unit."""

TEXT = """\
# The plant.
[site]
name = "Mill 7"   # on every page

[server]
data = "data"

[[bus]]
name = "dry-end"
port = "/dev/null"

[[bus.unit]]
id = 1            # the address
name = "Unwind"   # as people call it

# Of the nip.
[[bus.unit]]
id = 2
name = "Nip"

[[notify.webhook]]
url = "https://hooks.plant.example/s3cret"
secret_file = "hook.key"
"""


def written(folder: Path) -> Path:
    """The file, readable by others."""
    path = folder / "lineside.toml"
    path.write_text(TEXT, encoding="utf-8")
    path.chmod(0o644)
    return path


@dataclass(frozen=True)
class PlantFile:
    """The file, as an editor has it."""

    path: Path

    @property
    def text(self) -> str:
        """As it is now."""
        return self.path.read_text(encoding="utf-8")

    def write(self, text: str) -> None:
        """Change it by hand."""
        self.path.write_text(text, encoding="utf-8")


def mode_of(path: Path) -> int:
    """The rights of a file."""
    return stat.S_IMODE(path.stat().st_mode)


async def house_with_file(tmp_path: Path) -> AsyncIterator[House]:
    """A fixture: the app that runs with the file."""
    async with complete_app(tmp_path, config=written(tmp_path)) as house:
        yield house


def plant_file(tmp_path: Path) -> PlantFile:
    """A fixture: the file of that app."""
    return PlantFile(tmp_path / "lineside.toml")


def fields_of(page: str) -> dict[str, str]:
    """What a browser would send of the form of a page: its fields with their values."""
    form = re.findall(r'<form[^>]*action="/configuration.*?</form>', page, re.DOTALL)[-1]
    fields = {}
    for tag in re.findall(r"<input[^>]*>", form, re.DOTALL):
        attributes = dict(re.findall(r'([\w-]+)="([^"]*)"', tag))
        if attributes.get("type") != "checkbox" or " checked" in tag:
            fields[attributes["name"]] = unescape(attributes["value"])
    for name, options in re.findall(r'<select[^>]*name="([^"]+)"(.*?)</select>', form, re.DOTALL):
        fields[name] = re.findall(r'value="([^"]*)" selected', options)[0]
    return fields


async def form_of(client: httpx.AsyncClient, path: str = UNIT, **typed: str) -> dict[str, str]:
    """What a browser would send of a page after a person has typed."""
    page = await client.get(path)
    assert page.status_code == 200, page.text
    return {**fields_of(page.text), "act": "change", **typed}
