"""``lineside check``: the configuration, read and judged."""

from __future__ import annotations

from pathlib import Path

import typer

from app.cli.ending import ending
from app.cli.serve import LINESIDE_TOML, Config
from app.settings import load


def register(cli: typer.Typer) -> None:
    """Add the command."""
    cli.command()(check)


def check(config: Config = LINESIDE_TOML) -> None:
    """Read the configuration and say what is wrong, by file and line. Exit 0 or 1."""
    with ending():
        settings = load(config)
    typer.echo(f"{config}: {settings.site.name}, data in {settings.server.data}")
    for bus in settings.bus:
        absent = "" if "://" in bus.port or Path(bus.port).exists() else ", which is not there now"
        typer.echo(f"  {bus.name}: {len(bus.unit)} units at {bus.port}{absent}, {bus.baud} baud")
