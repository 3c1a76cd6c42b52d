"""``lineside serve``: the dashboard and one bus worker for each ``[[bus]]``."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from app.cli.ending import complain, report
from app.cli.options import config_option
from app.cli.serving.listening import listen
from app.cli.setup.service_unit import WRONG_CONFIGURATION
from app.core.database.migration import presence_of, refusal_to_start
from app.core.server.service_manager import ServiceManager
from app.errors import StoreError
from app.people.audit.keys import find_key_file
from app.settings import Settings, load
from bus.configuration import ConfigurationError
from bus.instants import monotonic_now
from bus.messages import Message

NEW = "--new"


@click.command
@config_option
@click.option(NEW, is_flag=True, help="Begin a new site where the store is missing, empty or damaged.")
def serve(config: Path, new: bool) -> None:
    """Serve the dashboard and every bus, until Ctrl-C or SIGTERM."""
    manager = ServiceManager()
    with configuration_refused(manager):
        settings = load(config)
    for notice in settings.former_notices:
        report(notice, err=True)
    choose, since = Message.of("choose_port_configured", file=str(config)), monotonic_now()
    with listen(settings.server.host, settings.server.port, choose) as port:
        check_store(settings, new=new)
        from app.cli.serving.hosting import host

        if new:
            from app.cli.serving.new_site import begin_new_site

            begin_new_site(settings)
        restarts = host(settings, config.resolve(), port, manager, since)
    if restarts:
        # The same command in the same process, which a service manager goes on to watch. What the server had
        # open is closed by now, and no descriptor is inherited. The site is no new one any more.
        words = (word for word in sys.orig_argv[1:] if word != NEW)
        os.execv(sys.executable, [sys.executable, *words])


@contextmanager
def configuration_refused(manager: ServiceManager) -> Iterator[None]:
    """A service whose configuration is wrong ends with an exit code that systemd does not start again."""
    try:
        yield
    except ConfigurationError as error:
        if not manager.is_there:
            raise
        complain(error.message)
        raise click.exceptions.Exit(WRONG_CONFIGURATION) from error


def check_store(settings: Settings, *, new: bool = False) -> None:
    """Raises StoreError where the main store is missing, empty or damaged and no first start explains that;
    with ``new`` where one is there."""
    store = settings.server.store
    refusal = refusal_to_start(store, presence_of(store), find_key_file(settings.key_files), new=new)
    if refusal is not None:
        raise StoreError(refusal)
