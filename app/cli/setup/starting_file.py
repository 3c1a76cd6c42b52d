"""The text of a first lineside.toml, and how a bus comes into one that has none."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from app.cli.setup.service_unit import DATA
from app.system.configuration.document import content_of, with_values, without
from app.system.configuration.port_scan import BY_ID, adapters

USUAL_PORT = "/dev/ttyUSB0"
STARTER = Path(__file__).with_name("starter.toml")
BUS = "# One [[bus]] for each RS-422 cable.\n"
"""Of the starter: what follows is the bus."""
NO_BUS = f"{BUS}# Not set yet: sudo lineside init, or the page Configuration.\n"


def likely_port(folder: Path = BY_ID) -> str:
    """Return the first serial adapter, else a usual name."""
    return next(iter(adapters(folder)), USUAL_PORT)


def starter(config: Path, port: str) -> str:
    """Return the text of a new configuration. JSON's strings are TOML's too."""
    text = STARTER.read_text(encoding="utf-8")
    for name, value in {"config": str(config), "quoted_port": json.dumps(port), "port": port}.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def first_configuration(path: Path) -> str:
    """Return what a service begins with at ``path``: it serves, and has no bus yet."""
    # Below the folder that the service may write in: the anchor of the audit log is beside the data.
    text = without_bus(path)
    return re.sub(r'^data = ".*"', f"data = {json.dumps(str(DATA / 'data'))}", text, flags=re.M)


def without_bus(config: Path) -> str:
    """Return the starter without its example of a bus."""
    return starter(config, USUAL_PORT).partition(BUS)[0] + NO_BUS


def example_bus(config: Path, port: str) -> str:
    """Return the starter's example of a bus, with comments."""
    return starter(config, port).partition(BUS)[2]


def has_own_bus(text: str) -> bool:
    """Whether a text has a bus that a person set up, or is no TOML: such a file is kept as it is. The example
    of the starter is none, at whatever port."""
    data = content_of(text)
    return data is None or bool(_buses(data) and _shape(data) != _shape(tomllib.loads(starter(Path(), ""))))


def with_bus(text: str, table: str) -> str:
    """Add ``table`` in place of the starter's example, if there is one."""
    if _buses(tomllib.loads(text)):
        text = without(text, ("bus", 0))
    return f"{text.rstrip()}\n\n{table}"


def with_names(text: str, site: str, names: dict[int, str]) -> str:
    """Set the name of the site and, by address, those of the units of the only bus."""
    text = with_values(text, ("site",), {"name": site})
    for index, unit in enumerate(tomllib.loads(text)["bus"][0]["unit"]):
        if unit["id"] in names:
            text = with_values(text, ("bus", 0, "unit", index), {"name": names[unit["id"]]})
    return text


def _buses(data: Any) -> Any:
    return data.get("bus", [])


def _shape(data: Any) -> Any:
    buses = _buses(data)
    return [{**bus, "port": ""} for bus in buses] if all(isinstance(bus, dict) for bus in buses) else buses
