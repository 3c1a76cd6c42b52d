"""``lineside certificate``: a site's own authority, and the certificates of its server and workers."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import report, wrong_option
from app.cli.options import CommandGroup, Option
from app.cli.setup.authority import AUTHORITY_DAYS, DAYS, AuthorityError, CertificateAuthority
from app.cli.setup.rights import become_owner_of
from app.settings import HostName, ServerSettings, Settings, host_name, load
from bus.messages import Message

FOLDER = "certificates"
ELSEWHERE = ("192.0.2.1", "2001:db8::1")
"""Addresses of documentation (RFC 5737, RFC 3849): the system names the address that it would send from."""
EVERY_ADDRESS = ("0.0.0.0", "::", "[::]")

certificate = CommandGroup(help="Create and renew certificates.")


@certificate.add("create")
def create(
    config: Config = LINESIDE_TOML,
    name: Annotated[
        list[str] | None,
        Option(help="A further name or address under which the dashboard is opened; may be repeated."),
    ] = None,
) -> None:
    """Create an authority of the site, a certificate of the server and one of each bus worker, or renew them.

    The authority is made once; a certificate of another authority is never overwritten.
    """
    settings = load(config)
    names = server_names(settings.server, [_name(each) for each in name or ()])
    become_owner_of(config.resolve().parent)
    folder = config.resolve().parent / FOLDER
    _refuse_missing_folder(settings.server, folder)
    authority = CertificateAuthority(folder, settings.site.name)
    report(Message.of("authority_at", file=str(authority.certificate), years=AUTHORITY_DAYS // 365))
    for made, key, kind, called in _certificates(settings, folder):
        of_server = names if kind == "server" else ()
        is_renewal = authority.issue(made, key, kind, called, of_server)
        code = "certificate_renewed" if is_renewal else "certificate_created"
        report(Message.of(code, file=str(made), names=", ".join(of_server) or called, days=DAYS))
    if settings.server.tls is None:
        report(Message.of("certificate_to_configure", folder=FOLDER))


def _refuse_missing_folder(server: ServerSettings, own: Path) -> None:
    """Before anything is made; ``own`` comes with the authority. Raises AuthorityError."""
    for file in () if server.tls is None else (server.tls.certificate, server.tls.key):
        if file.parent.resolve() != own and not file.parent.is_dir():
            raise AuthorityError(Message.of("certificate_folder_missing", folder=str(file.parent)))


def _name(written: str) -> HostName:
    try:
        return host_name(written)
    except ValueError as error:
        raise wrong_option("--name", "setting_host_name") from error


def server_names(server: ServerSettings, further: list[HostName]) -> list[str]:
    """The names and addresses under which the dashboard may be opened, each once."""
    host = [] if server.host in EVERY_ADDRESS else [server.host.strip("[]")]
    found = [socket.gethostname(), socket.getfqdn(), *host, *server.allowed_hosts, *further, *own_addresses()]
    return list(dict.fromkeys([*found, "localhost", "127.0.0.1", "::1"]))


def own_addresses() -> Iterator[str]:
    """The addresses from which this machine sends to others. Nothing is sent."""
    for family, address in zip((socket.AF_INET, socket.AF_INET6), ELSEWHERE, strict=True):
        with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((address, 9))
            yield str(probe.getsockname()[0])


def _certificates(settings: Settings, folder: Path) -> Iterator[tuple[Path, Path, str, str]]:
    """Certificate, key, kind and name of each."""
    tls = settings.server.tls
    here = (folder / "server.pem", folder / "server.key") if tls is None else (tls.certificate, tls.key)
    yield *here, "server", socket.gethostname()
    for bus in settings.bus:
        yield folder / f"worker-{bus.name}.pem", folder / f"worker-{bus.name}.key", "worker", bus.name
