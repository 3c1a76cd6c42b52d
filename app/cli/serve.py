"""The command ``lineside serve``, which takes the TCP port, then starts the dashboard and one bus worker for
each ``[[bus]]``; and ``lineside worker``: one bus worker on a machine near the port. Imports are few, so that
a port in use is reported at once."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from app.cli.command import (
    LINESIDE_TOML,
    PATH,
    WRONG_CONFIGURATION,
    bearer_token,
    complain,
    config_option,
    report,
    token_file_option,
    token_option,
)
from app.cli.starting import check_store, listen
from app.core.server.service_manager import ServiceManager
from app.settings import load
from bus.configuration import ConfigurationError, load_bus
from bus.errors import CallerError
from bus.instants import monotonic_now
from bus.messages import Message

if TYPE_CHECKING:
    from bus.worker.uplink import UplinkTls

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
        # Run the same command in the same process, which a service manager watches. The server's files are
        # closed by now, and no descriptor is inherited. The site is not new any more.
        words = (word for word in sys.orig_argv[1:] if word != NEW)
        os.execv(sys.executable, [sys.executable, *words])


@contextmanager
def _configuration_refused(manager: ServiceManager) -> Iterator[None]:
    """End a service with a wrong configuration with an exit code after which systemd does not start it
    again."""
    try:
        yield
    except ConfigurationError as error:
        if not manager.is_there:
            raise
        complain(error.message)
        raise click.exceptions.Exit(WRONG_CONFIGURATION) from error


WORKER_TOKEN_VARIABLE = "LINESIDE_WORKER_TOKEN"


@click.command
@click.option("--bus", required=True, help="Name of the bus in the configuration.")
@click.option(
    "--app",
    required=True,
    multiple=True,
    help="Address of the dashboard, http://host:port; may be repeated for that of its spare.",
)
@token_option
@token_file_option
@click.option("--config", type=PATH, default=LINESIDE_TOML, help="The configuration that has the bus.")
@click.option("--ca", type=PATH, help="Certificate of the dashboard's authority, by default this machine's.")
@click.option("--certificate", type=PATH, help="The worker's certificate, where the dashboard demands one.")
@click.option("--key", type=PATH, help="Its private key.")
def worker(
    bus: str,
    app: Sequence[str],
    token: str,
    token_file: Path | None,
    config: Path,
    ca: Path | None,
    certificate: Path | None,
    key: Path | None,
) -> None:
    """Run one bus worker for a dashboard elsewhere, until Ctrl-C or SIGTERM; reconnect indefinitely."""
    for url in app:
        if not url.startswith(("http://", "https://", "ws://", "wss://")):
            raise CallerError(Message.of("app_url_malformed", url=url))
    bearer = bearer_token(token, token_file, WORKER_TOKEN_VARIABLE)
    settings = load_bus(config, bus)
    tls = _tls(app, ca, certificate, key)
    from bus.worker.service import run

    raise click.exceptions.Exit(run(settings, app, bearer, tls=tls))


def _tls(
    apps: Sequence[str], ca: Path | None, certificate: Path | None, key: Path | None
) -> UplinkTls | None:
    """Return the TLS settings of the link. Raise CallerError for options that do not fit together and files
    that cannot be used."""
    if not any(url.startswith(("https://", "wss://")) for url in apps):
        if ca or certificate or key:
            raise CallerError(Message.of("app_url_in_clear", url=apps[0]))
        return None
    if (certificate is None) != (key is None):
        raise CallerError(Message("certificate_without_key"))
    from bus.worker.uplink import UplinkTls

    tls = UplinkTls(ca, (certificate, key) if certificate and key else None)
    tls.context()
    return tls
