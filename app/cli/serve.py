"""``lineside serve``: the dashboard and one bus worker for each ``[[bus]]``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.cli.check_store import check_store
from app.cli.listening import listen
from app.settings import load
from bus.messages import Message

Config = Annotated[Path, typer.Option(help="The configuration, lineside.toml.")]
LINESIDE_TOML = Path("lineside.toml")


def serve(
    config: Config = LINESIDE_TOML,
    new: Annotated[
        bool, typer.Option("--new", help="Begin a new site where the store is missing, empty or damaged.")
    ] = False,
) -> None:
    """Serve the dashboard and every bus, until Ctrl-C or SIGTERM."""
    settings = load(config)
    check_store(settings, new=new)
    choose = Message.of("choose_port_configured", file=str(config))
    with listen(settings.server.host, settings.server.port, choose) as port:
        from app.cli.hosting import host

        if new:
            from app.cli.new_site import begin_new_site

            begin_new_site(settings)
        host(settings, config.resolve(), port)
