"""``lineside worker``: one bus worker alone, on a machine near the port."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.cli.credentials import TokenFile, TokenOption, bearer_token
from app.cli.ending import ending
from bus.configuration import load_bus
from bus.errors import CallerError
from bus.messages import Message

WORKER_TOKEN_VARIABLE = "LINESIDE_WORKER_TOKEN"


def worker(
    bus: Annotated[str, typer.Option(help="Name of the bus in the configuration.")],
    app: Annotated[str, typer.Option(help="Address of the dashboard, http://host:port.")],
    token: TokenOption = "",
    token_file: TokenFile = None,
    config: Annotated[Path, typer.Option(help="The configuration that has the bus.")] = Path("lineside.toml"),
) -> None:
    """Run one bus worker for a dashboard elsewhere, until Ctrl-C or SIGTERM; reconnects indefinitely."""
    with ending():
        if not app.startswith(("http://", "https://", "ws://", "wss://")):
            raise CallerError(Message.of("app_url_malformed", url=app))
        bearer = bearer_token(token, token_file, WORKER_TOKEN_VARIABLE)
        settings = load_bus(config, bus)
        from bus.worker.process import run

        raise typer.Exit(run(settings, app, bearer))
