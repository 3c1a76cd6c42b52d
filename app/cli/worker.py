"""``lineside worker``: one bus worker alone, on a machine near the port."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.cli.ending import ending
from bus.configuration import load_bus
from bus.errors import CallerError


def register(cli: typer.Typer) -> None:
    """Add the command."""
    cli.command()(worker)


def worker(
    bus: Annotated[str, typer.Option(help="Name of the bus, as the configuration says it.")],
    app: Annotated[str, typer.Option(help="Address of the dashboard, http://host:port.")],
    token: Annotated[str, typer.Option(help="A bearer token.", envvar="LINESIDE_WORKER_TOKEN")],
    config: Annotated[Path, typer.Option(help="The configuration that has the bus.")] = Path("lineside.toml"),
) -> None:
    """Work one bus for a dashboard elsewhere, until Ctrl-C or SIGTERM; it reconnects for ever."""
    with ending():
        if not app.startswith(("http://", "https://", "ws://", "wss://")):
            raise CallerError(f"--app {app!r} is no address; give for example http://192.168.1.10:8000")
        settings = load_bus(config, bus)
        from bus.worker.process import run

        raise typer.Exit(run(settings, app, token))
