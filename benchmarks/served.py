"""Lineside as a host for a line: a configuration and the command that serves it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from tests.e2e.site import free_port, unit_tables

CONFIG = "lineside.toml"
LINESIDE = Path(sys.executable).with_name("lineside")


def served_line(folder: Path, port: str, units: int) -> list[str]:
    """Write lineside.toml for a port; the command to run."""
    config = folder / CONFIG
    bus = f'[server]\nport = {free_port()}\n\n[[bus]]\nname = "line"\nport = {json.dumps(port)}\n'
    config.write_text(bus + unit_tables(units), encoding="utf-8")
    return [str(LINESIDE), "serve", "--config", str(config)]
