"""``lineside serve``: takes the TCP port, then starts the dashboard and one bus worker for each ``[[bus]]``.
It imports little, so that a port in use is reported at once."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from app.cli.options import config_option
from app.cli.process import WRONG_CONFIGURATION, complain, report
from app.cli.starting import check_store, listen
from app.core.server.service_manager import ServiceManager
from app.settings import load
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
    with _configuration_refused(manager):
        settings = load(config)
    for notice in settings.former_notices:
        report(notice, err=True)
    choose, since = Message.of("choose_port_configured", file=str(config)), monotonic_now()
    with listen(settings.server.host, settings.server.port, choose) as port:
        check_store(settings, new=new)
        from app.cli.hosting import host

        if new:
            from app.cli.site import begin_new_site

            begin_new_site(settings)
        restarts = host(settings, config.resolve(), port, manager, since)
    if restarts:
        # The same command in the same process, which a service manager goes on to watch. What the server had
        # open is closed by now, and no descriptor is inherited. The site is no new one any more.
        words = (word for word in sys.orig_argv[1:] if word != NEW)
        os.execv(sys.executable, [sys.executable, *words])


@contextmanager
def _configuration_refused(manager: ServiceManager) -> Iterator[None]:
    """End a service whose configuration is wrong with an exit code after which systemd does not start it
    again."""
    try:
        yield
    except ConfigurationError as error:
        if not manager.is_there:
            raise
        complain(error.message)
        raise click.exceptions.Exit(WRONG_CONFIGURATION) from error
