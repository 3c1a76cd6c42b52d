"""Lineside as a host for a line: a configuration and the command that serves it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from tests.e2e.site import LINESIDE, free_port, unit_tables

CONFIG = "lineside.toml"


def served_line(folder: Path, port: str, units: int, more: str = "") -> list[str]:
    """Write lineside.toml for a port, with ``more`` tables; return the command to run."""
    return served_lines(folder, [port], units, more)


def served_lines(folder: Path, ports: Sequence[str], units: int, more: str = "") -> list[str]:
    """Write lineside.toml for several ports, each with so many units; return the command to run."""
    config = folder / CONFIG
    buses = "".join(_bus(place, port) + unit_tables(units) for place, port in enumerate(ports))
    config.write_text(f"[server]\nport = {free_port()}\n{more}{buses}", encoding="utf-8")
    return [str(LINESIDE), "serve", "--config", str(config)]


def _bus(place: int, port: str) -> str:
    return f'\n[[bus]]\nname = "line{place or ""}"\nport = {json.dumps(port)}\n'
