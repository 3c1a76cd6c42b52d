"""``lineside certificate``: a site's own authority, and the certificates of its server and workers."""

from __future__ import annotations

import secrets
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path

import click

from app.cli.ending import report, wrong_option
from app.cli.options import config_option
from app.cli.setup.rights import become_owner_of
from app.settings import HostName, ServerSettings, Settings, host_name, load
from bus.errors import LinesideError
from bus.messages import Message

FOLDER = "certificates"
ELSEWHERE = ("192.0.2.1", "2001:db8::1")
"""Addresses of documentation (RFC 5737, RFC 3849): the system names the address that it would send from."""
EVERY_ADDRESS = ("0.0.0.0", "::", "[::]")
AUTHORITY_DAYS = 3650
DAYS = 730
"""Browsers refuse a server's certificate of more than 825 days, also of a site's own authority."""
SERIAL_BYTES = 8
WITHIN_S = 60.0
_ISSUED = "basicConstraints = critical, CA:FALSE\nkeyUsage = critical, digitalSignature\n"
_IDENTIFIERS = "subjectKeyIdentifier = hash\nauthorityKeyIdentifier = keyid\n"
_EXTENSIONS = {
    "ca": "basicConstraints = critical, CA:TRUE, pathlen:0\nkeyUsage = critical, keyCertSign, cRLSign\n"
    "subjectKeyIdentifier = hash\n",
    "server": f"{_ISSUED}{_IDENTIFIERS}extendedKeyUsage = serverAuth\n",
    "worker": f"{_ISSUED}{_IDENTIFIERS}extendedKeyUsage = clientAuth\n",
}
_REQUEST = "[req]\ndistinguished_name = subject\nprompt = no\nutf8 = yes\n[subject]\n"


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

    The authority is made once; a certificate of another authority is never overwritten.
    """
    settings = load(config)
    names = server_names(settings.server, [_name(each) for each in name])
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


class AuthorityError(LinesideError):
    """Nothing was overwritten; the text gives the reason and what to do."""


class CertificateAuthority:
    """``ca.pem`` and ``ca.key`` of a folder, made where neither is there. Raises AuthorityError."""

    def __init__(self, folder: Path, site: str) -> None:
        self._openssl = shutil.which("openssl")
        if self._openssl is None:
            raise AuthorityError(Message("openssl_missing"))
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.certificate, self._key = folder / "ca.pem", folder / "ca.key"
        if self._key.exists() != self.certificate.exists():
            missing = self._key if self.certificate.exists() else self.certificate
            raise AuthorityError(Message.of("authority_incomplete", file=str(missing)))
        if not self._key.exists():
            self._make_key(self._key)
            name = f"{site} authority"
            signed = ("-x509", "-days", str(AUTHORITY_DAYS), "-extensions", "ca", "-set_serial", _serial())
            self._write(
                self.certificate,
                lambda out: self._request(self._key, name, "ca", out, *signed),
            )

    def issue(self, certificate: Path, key: Path, kind: str, name: str, names: Sequence[str] = ()) -> bool:
        """Make a certificate, or renew one that this authority has signed, with the key that is there; return
        whether it is a renewal. ``kind``: server or worker; ``names``: host names and addresses."""
        is_renewal = certificate.exists()
        if is_renewal and not self._has_signed(certificate):
            raise AuthorityError(Message.of("certificate_is_foreign", file=str(certificate)))
        if not key.exists():
            self._make_key(key)
        self._write(certificate, lambda out: self._sign(key, kind, name, names, out))
        return is_renewal

    def _sign(self, key: Path, kind: str, name: str, names: Sequence[str], out: Path) -> None:
        request, extensions = out.with_name("request"), out.with_name("extensions")
        extensions.write_text(f"[{kind}]\n{_EXTENSIONS[kind]}{_alternatives(names)}", encoding="utf-8")
        self._request(key, name, kind, request)
        self._run(
            *("x509", "-req", "-sha256", "-in", request, "-CA", self.certificate, "-CAkey", self._key),
            *("-set_serial", _serial(), "-days", str(DAYS)),
            *("-extfile", extensions, "-extensions", kind, "-out", out),
        )

    def _request(self, key: Path, name: str, kind: str, out: Path, *options: str) -> None:
        config = out.with_name("config")
        config.write_text(f"{_REQUEST}CN = {_quoted(name)}\n[{kind}]\n{_EXTENSIONS[kind]}", encoding="utf-8")
        self._run("req", "-new", "-sha256", "-config", config, "-key", key, "-out", out, *options)

    def _make_key(self, file: Path) -> None:
        self._write(
            file, lambda out: self._run("ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", out)
        )

    def _has_signed(self, certificate: Path) -> bool:
        verified = self._called(
            "verify", "-no_check_time", "-partial_chain", "-CAfile", self.certificate, certificate
        )
        return verified.returncode == 0

    def _write(self, file: Path, make: Callable[[Path], None]) -> None:
        """All of it or nothing: a server may read it at the same moment."""
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=".certificate-") as folder:
            out = Path(folder) / "out"
            make(out)
            out.chmod(0o600)
            out.replace(file)

    def _run(self, *words: str | Path) -> None:
        done = self._called(*words)
        if done.returncode:
            *_, error = ["", *done.stderr.decode("utf-8", "replace").strip().splitlines()]
            raise AuthorityError(Message.of("openssl_failed", error=error or str(done.returncode)))

    def _called(self, *words: str | Path) -> subprocess.CompletedProcess[bytes]:
        assert self._openssl is not None
        return subprocess.run(
            [self._openssl, *map(str, words)], stdin=subprocess.DEVNULL, capture_output=True, timeout=WITHIN_S
        )


def _serial() -> str:
    return f"0x{secrets.token_hex(SERIAL_BYTES)}"


def _quoted(name: str) -> str:
    """As a value of openssl's configuration, in which some signs have a meaning."""
    plain = "".join(each if each.isalnum() or each in " ._-" else "_" for each in name)
    return plain[:64].strip() or "Lineside"


def _alternatives(names: Sequence[str]) -> str:
    entries = ",".join(f"{_kind_of(name)}:{name}" for name in names)
    return f"subjectAltName = {entries}\n" if entries else ""


def _kind_of(name: str) -> str:
    try:
        ip_address(name)
    except ValueError:
        return "DNS"
    return "IP"
