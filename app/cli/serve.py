"""``lineside serve``: takes the TCP port, then starts the dashboard and one bus worker for each ``[[bus]]``.
It imports little, so that a port in use is reported at once."""

from __future__ import annotations

import errno
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import click

from app.cli.options import config_option
from app.cli.process import WRONG_CONFIGURATION, complain, report
from app.core.database.migration import presence_of, refusal_to_start
from app.core.server.service_manager import ServiceManager
from app.errors import StoreError, system_error
from app.people.audit.keys import find_key_file
from app.settings import Settings, load
from bus.configuration import ConfigurationError
from bus.errors import LinesideError
from bus.instants import monotonic_now
from bus.messages import Message

BACKLOG = 512
"""Browsers of a plant reconnect at once after a restart."""
NEXT_PORTS = 10
NEW = "--new"


class ListenError(LinesideError):
    """The dashboard's port cannot be taken; the text gives the reason and what to do."""


class PortInUse(ListenError):
    """Another program has the port."""


def listen_from(host: str, first: int, choose: Message) -> socket.socket:
    """Take ``first`` of ``host``, or else the next port that is free. Raises ListenError."""
    for port in range(first, first + NEXT_PORTS):
        with suppress(PortInUse):
            return listen(host, port, choose)
    return listen(host, first, choose)


def listen(host: str, port: int, choose: Message) -> socket.socket:
    """Take ``port`` of ``host``. ``choose``: how the caller chooses another port. Raises ListenError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    both = host == "::" and socket.has_dualstack_ipv6()
    try:
        return socket.create_server((host, port), family=family, backlog=BACKLOG, dualstack_ipv6=both)
    except (OSError, OverflowError) as error:
        in_use = getattr(error, "errno", None) == errno.EADDRINUSE
        raise (PortInUse if in_use else ListenError)(_reason(host, port, choose, error)) from error


def _reason(host: str, port: int, choose: Message, error: Exception) -> Message:
    number = getattr(error, "errno", None)
    if number is not None and number < 0:  # EAI_…: create_server passes on what getaddrinfo(3) returned
        return Message.of("listen_no_host", host=host)
    match number:
        case errno.EADDRINUSE:
            return Message.of("listen_port_in_use", port=port, host=host, choose=choose)
        case errno.EACCES:
            return Message.of("listen_port_reserved", port=port, host=host, choose=choose)
        case errno.EADDRNOTAVAIL:
            return Message.of("listen_foreign_address", host=host)
        case _:
            return Message.of("listen_failed", port=port, host=host, error=system_error(error))


def url_of(host: str, port: int, scheme: str = "http") -> str:
    """Return the URL by which a browser or a worker on this machine finds the dashboard that listens on
    ``host``."""
    if host == "0.0.0.0" or (host == "::" and socket.has_dualstack_ipv6()):
        host = "127.0.0.1"
    elif host == "::":
        host = "::1"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


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


def check_store(settings: Settings, *, new: bool = False) -> None:
    """Raise StoreError if the main store is missing, empty or damaged and no first start explains that; with
    ``new`` if there is a sound one."""
    store = settings.server.store
    refusal = refusal_to_start(store, presence_of(store), find_key_file(settings.key_files), new=new)
    if refusal is not None:
        raise StoreError(refusal)
