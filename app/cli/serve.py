"""``lineside serve``: the dashboard and one bus worker for each ``[[bus]]``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from app.audit.keys import find_key_file
from app.cli.ending import report
from app.cli.listening import listen
from app.database.opening import look_at, main_presence
from app.database.presence import refusal_to_start
from app.database.settings import StoreSettings
from app.errors import StoreError, StoreUnavailableError
from app.settings import Settings, load
from bus.instants import monotonic_now
from bus.messages import Message

WAIT_S, RETRY_S = 60.0, 1.0
"""How long a start waits for the database, and how often it tries."""
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
    await_database(settings.store)
    check_store(settings, new=new)
    choose = Message.of("choose_port_configured", file=str(config))
    with listen(settings.server.host, settings.server.port, choose) as port:
        from app.cli.hosting import host

        if new:
            from app.cli.new_site import begin_new_site

            begin_new_site(settings)
        host(settings, config.resolve(), port)


def await_database(store: StoreSettings, wait_s: float = WAIT_S) -> None:
    """Wait until a database of another machine responds: after a failure of power both start together. Raises
    StoreError once ``wait_s`` is over; a service manager starts the server again."""
    if not store.url:
        return
    ends, is_reported = monotonic_now() + wait_s, False
    while True:
        try:
            look_at(store)
        except StoreUnavailableError as error:
            if monotonic_now() > ends:
                raise StoreError(
                    Message.of("store_away_at_start", reason=error.message, seconds=round(wait_s))
                ) from error
            if not is_reported:
                report(Message.of("store_awaited", reason=error.message, seconds=round(wait_s)), err=True)
            is_reported = True
            time.sleep(RETRY_S)
        else:
            return


def check_store(settings: Settings, *, new: bool = False) -> None:
    """Raises StoreError where the main store is missing, empty or damaged and no first start explains that;
    with ``new`` where one is there."""
    presence = main_presence(settings.store, settings.server.store)
    refusal = refusal_to_start(settings.store_name, presence, find_key_file(settings.key_files), new=new)
    if refusal is not None:
        raise StoreError(refusal)
