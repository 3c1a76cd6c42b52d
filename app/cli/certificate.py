"""The command ``lineside certificate``: a site's authority and certificates of its server and workers."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes, PublicKeyTypes
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from app.cli.command import become_owner_of, config_option, report, wrong_option
from app.core.database.files import write_file
from app.settings import HostName, ServerSettings, Settings, host_name, load
from app.system.opcua.access import alternative_name, key_usage
from bus.errors import LinesideError
from bus.instants import unix_now
from bus.messages import Message

FOLDER = "certificates"
ELSEWHERE = ("192.0.2.1", "2001:db8::1")
"""Addresses for documentation (RFC 5737, RFC 3849), for which the system names its sending address."""
EVERY_ADDRESS = ("0.0.0.0", "::", "[::]")
AUTHORITY_DAYS = 3650
DAYS = 730
"""Browsers refuse a server certificate of more than 825 days, even from a site's own authority."""
_PURPOSES = {"server": ExtendedKeyUsageOID.SERVER_AUTH, "worker": ExtendedKeyUsageOID.CLIENT_AUTH}


@click.group
def certificate() -> None:
    """Create and renew certificates."""


@certificate.command
@config_option
@click.option(
    "--name",
    multiple=True,
    help="A further name or address under which the dashboard is opened; may be repeated.",
)
def create(config: Path, name: Sequence[str]) -> None:
    """Create an authority of the site, a certificate of the server and one of each bus worker, or renew them.

    The authority is created once; a certificate of another authority is never overwritten.
    """
    settings = load(config)
    names = server_names(settings.server, [_name(each) for each in name])
    become_owner_of(config.resolve().parent)
    folder = config.resolve().parent / FOLDER
    _refuse_missing_folder(settings.server, folder)
    authority = CertificateAuthority(folder, settings.site.name)
    report(Message.of("authority_at", file=str(authority.file), years=AUTHORITY_DAYS // 365))
    for made, key, kind, called in _certificates(settings, folder):
        of_server = names if kind == "server" else ()
        is_renewal = authority.issue(made, key, kind, called, of_server)
        code = "certificate_renewed" if is_renewal else "certificate_created"
        report(Message.of(code, file=str(made), names=", ".join(of_server) or called, days=DAYS))
    if settings.server.tls is None:
        report(Message.of("certificate_to_configure", folder=FOLDER))


def _refuse_missing_folder(server: ServerSettings, own: Path) -> None:
    """Raise AuthorityError for a missing folder, before anything is created. ``own`` is created with the
    authority."""
    for file in () if server.tls is None else (server.tls.certificate, server.tls.key):
        if file.parent.resolve() != own and not file.parent.is_dir():
            raise AuthorityError(Message.of("certificate_folder_missing", folder=str(file.parent)))


def _name(written: str) -> HostName:
    try:
        return host_name(written)
    except ValueError as error:
        raise wrong_option("--name", "setting_host_name") from error


def server_names(server: ServerSettings, further: list[HostName]) -> list[str]:
    """Return the names and addresses of the dashboard, each once."""
    host = [] if server.host in EVERY_ADDRESS else [server.host.strip("[]")]
    found = [socket.gethostname(), socket.getfqdn(), *host, *server.allowed_hosts, *further, *own_addresses()]
    return list(dict.fromkeys([*found, "localhost", "127.0.0.1", "::1"]))


def own_addresses() -> Iterator[str]:
    """Yield the addresses from which this machine would send to others; send nothing."""
    for family, address in zip((socket.AF_INET, socket.AF_INET6), ELSEWHERE, strict=True):
        with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((address, 9))
            yield str(probe.getsockname()[0])


def _certificates(settings: Settings, folder: Path) -> Iterator[tuple[Path, Path, str, str]]:
    """Yield the file of each certificate and of its key, with kind and name."""
    tls = settings.server.tls
    here = (folder / "server.pem", folder / "server.key") if tls is None else (tls.certificate, tls.key)
    yield *here, "server", socket.gethostname()
    for bus in settings.bus:
        yield folder / f"worker-{bus.name}.pem", folder / f"worker-{bus.name}.key", "worker", bus.name


class AuthorityError(LinesideError):
    """Raised if nothing was overwritten; the text gives the reason and the remedy."""


class CertificateAuthority:
    """The authority in ``ca.pem`` and ``ca.key`` of a folder, created if neither exists. Raises
    AuthorityError."""

    def __init__(self, folder: Path, site: str) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.file, key_file = folder / "ca.pem", folder / "ca.key"
        if key_file.exists() != self.file.exists():
            missing = key_file if self.file.exists() else self.file
            raise AuthorityError(Message.of("authority_incomplete", file=str(missing)))
        self._key = _key_in(key_file)
        if not self.file.exists():
            name = _subject(f"{site} authority")
            builder = _certificate_of(self._key.public_key(), name, name, AUTHORITY_DAYS)
            builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            usage = key_usage("key_cert_sign", "crl_sign")
            self._sign(self.file, builder.add_extension(usage, critical=True))
        certificate = _certificate_in(self.file)
        if certificate is None:
            raise AuthorityError(Message.of("tls_no_certificate", file=str(self.file)))
        self._certificate = certificate

    def issue(self, file: Path, key_file: Path, kind: str, name: str, names: Sequence[str] = ()) -> bool:
        """Create a certificate, or renew one that this authority has signed with the existing key; return
        whether it was renewed. ``kind``: server or worker; ``names``: host names and addresses."""
        is_renewal = file.exists()
        if is_renewal and not self._has_signed(_certificate_in(file)):
            raise AuthorityError(Message.of("certificate_is_foreign", file=str(file)))
        public_key = _key_in(key_file).public_key()
        builder = _certificate_of(public_key, _subject(name), self._certificate.subject, DAYS)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(key_usage("digital_signature"), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage([_PURPOSES[kind]]), critical=False)
        authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())  # type: ignore[arg-type]
        builder = builder.add_extension(authority, critical=False)
        if names:
            alternatives = x509.SubjectAlternativeName(map(alternative_name, names))
            builder = builder.add_extension(alternatives, critical=False)
        self._sign(file, builder)
        return is_renewal

    def _has_signed(self, certificate: x509.Certificate | None) -> bool:
        if certificate is None:
            return False
        try:
            certificate.verify_directly_issued_by(self._certificate)
        except (ValueError, TypeError, InvalidSignature):
            return False
        return True

    def _sign(self, file: Path, builder: x509.CertificateBuilder) -> None:
        certificate = builder.sign(self._key, hashes.SHA256())  # type: ignore[arg-type]
        write_file(file, certificate.public_bytes(Encoding.PEM))


def _key_in(file: Path) -> PrivateKeyTypes:
    """Read a private key, or create it if the file does not exist. Raise AuthorityError."""
    if not file.exists():
        key = ec.generate_private_key(ec.SECP256R1())
        write_file(file, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    try:
        return load_pem_private_key(file.read_bytes(), None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:  # TypeError: it is encrypted
        raise AuthorityError(Message.of("certificate_key_unusable", file=str(file))) from error


def _certificate_in(file: Path) -> x509.Certificate | None:
    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except ValueError:
        return None


def _certificate_of(
    key: PublicKeyTypes, subject: x509.Name, issuer: x509.Name, days: int
) -> x509.CertificateBuilder:
    begins = datetime.fromtimestamp(float(unix_now()), UTC)
    builder = x509.CertificateBuilder(issuer, subject, key, x509.random_serial_number())  # type: ignore[arg-type]
    builder = builder.not_valid_before(begins).not_valid_after(begins + timedelta(days=days))
    return builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)  # type: ignore[arg-type]


def _subject(name: str) -> x509.Name:
    """Return a name as a subject, which has at most 64 characters (RFC 5280, A.1)."""
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:64].strip() or "Lineside")])
