"""``lineside check``: the configuration, and whether this machine can do what it says."""

from __future__ import annotations

import typer

from app.cli.ending import ending
from app.cli.findings import findings
from app.cli.serve import LINESIDE_TOML, Config
from app.settings import load


def register(cli: typer.Typer) -> None:
    """Add the command."""
    cli.command()(check)


def check(config: Config = LINESIDE_TOML) -> None:
    """Check the configuration and this machine; faults are listed by file and line. Exit 0 or 1."""
    with ending():
        settings = load(config)
        typer.echo(f"{config}: {settings.site.name}")
        faults = 0
        for finding in findings(settings):
            faults += finding.is_fault
            typer.echo(f"{'lineside:' if finding.is_fault else ' '} {finding.text}", err=finding.is_fault)
        if faults:
            raise typer.Exit(1)
