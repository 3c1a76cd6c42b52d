"""``lineside worker``: one bus worker alone, on a machine near the port."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from app.cli.api.credentials import TokenFile, TokenOption, bearer_token
from app.cli.config_option import LINESIDE_TOML
from app.cli.options import Option
from bus.configuration import load_bus
from bus.errors import CallerError
from bus.messages import Message

if TYPE_CHECKING:
    from bus.worker.uplink_tls import UplinkTls

WORKER_TOKEN_VARIABLE = "LINESIDE_WORKER_TOKEN"


def worker(
    bus: Annotated[str, Option(help="Name of the bus in the configuration.")],
    app: Annotated[
        list[str],
        Option(help="Address of the dashboard, http://host:port; may be repeated for that of its spare."),
    ],
    token: TokenOption = "",
    token_file: TokenFile = None,
    config: Annotated[Path, Option(help="The configuration that has the bus.")] = LINESIDE_TOML,
    ca: Annotated[
        Path | None, Option(help="Certificate of the dashboard's authority, by default this machine's.")
    ] = None,
    certificate: Annotated[
        Path | None, Option(help="The worker's certificate, where the dashboard demands one.")
    ] = None,
    key: Annotated[Path | None, Option(help="Its private key.")] = None,
) -> None:
    """Run one bus worker for a dashboard elsewhere, until Ctrl-C or SIGTERM; reconnects indefinitely."""
    for url in app:
        if not url.startswith(("http://", "https://", "ws://", "wss://")):
            raise CallerError(Message.of("app_url_malformed", url=url))
    bearer = bearer_token(token, token_file, WORKER_TOKEN_VARIABLE)
    settings = load_bus(config, bus)
    tls = _tls(app, ca, certificate, key)
    from bus.worker.process import run

    raise click.exceptions.Exit(run(settings, app, bearer, tls=tls))


def _tls(
    apps: Sequence[str], ca: Path | None, certificate: Path | None, key: Path | None
) -> UplinkTls | None:
    """What secures the link. Raises CallerError for options that do not fit and files that cannot be used."""
    if not any(url.startswith(("https://", "wss://")) for url in apps):
        if ca or certificate or key:
            raise CallerError(Message.of("app_url_in_clear", url=apps[0]))
        return None
    if (certificate is None) != (key is None):
        raise CallerError(Message("certificate_without_key"))
    from bus.worker.uplink_tls import UplinkTls

    tls = UplinkTls(ca, (certificate, key) if certificate and key else None)
    tls.context()
    return tls
