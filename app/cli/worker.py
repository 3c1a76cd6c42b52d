"""``lineside worker``: one bus worker alone, on a machine near the port."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from app.cli.options import LINESIDE_TOML, PATH, bearer_token, token_file_option, token_option
from bus.configuration import load_bus
from bus.errors import CallerError
from bus.messages import Message

if TYPE_CHECKING:
    from bus.worker.uplink import UplinkTls


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
    """Run one bus worker for a dashboard elsewhere, until Ctrl-C or SIGTERM; reconnects indefinitely."""
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
    """Return what secures the link. Raises CallerError for options that do not fit and files that cannot be
    used."""
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
