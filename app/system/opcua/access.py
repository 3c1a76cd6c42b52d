"""Certificates and tokens that give access by OPC UA: the certificate of this server, the clients that it
trusts by file, and the tokens of programs.

The folder has ``own`` (certificate and key), ``trusted`` (a client is trusted while its certificate is there)
and ``rejected`` (certificates of clients that tried; an engineer moves one to ``trusted``).
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import socket
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from app.core.database.files import make_folder, write_file
from app.people.auth.rules import secret_hash
from app.system.opcua.link import Key
from bus.errors import LinesideError
from bus.instants import UnixTime, unix_now
from bus.messages import Message

KEY_BITS = 2048
"""The length of the server's RSA key in bits; Basic256Sha256 allows 2048 to 4096 (OPC UA Part 7)."""
DAYS = 3650
RENEW_DAYS = 30
MAX_REJECTED = 20
MAX_CERTIFICATE = 8192
MAX_TRUSTED = 1000
SUFFIXES = (".der", ".crt", ".cer", ".pem")
_USAGES = (
    *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
    *("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
)


class AccessError(LinesideError):
    """Raised if certificates of the OPC UA server cannot be used; the message has the reason."""


@dataclass(frozen=True, slots=True)
class OwnCertificate:
    """The certificate of this server with its key and application URI."""

    certificate: x509.Certificate
    key: rsa.RSAPrivateKey
    uri: str


def certificate_file(folder: Path) -> Path:
    """Return the path of the certificate of this server."""
    return folder / "own" / "certificate.pem"


def own_certificate(folder: Path, names: Sequence[str], site: str, now: datetime) -> OwnCertificate:
    """Return the certificate of this server; create it at the first start, and again with the same key and
    URI before it ends. Raise AccessError."""
    file, key_file = certificate_file(folder), folder / "own" / "key.pem"
    try:
        for each in (folder, file.parent, folder / "trusted", folder / "rejected"):
            make_folder(each)
        key = _own_key(key_file)
        certificate = x509.load_pem_x509_certificate(file.read_bytes()) if file.exists() else None
        if certificate is None or certificate.not_valid_after_utc < now + timedelta(days=RENEW_DAYS):
            uri = uri_of(certificate) if certificate else ""
            uri = uri or f"urn:{socket.gethostname()}:lineside:{secrets.token_hex(6)}"
            certificate = _signed(key, uri, names, site, now)
            write_file(file, certificate.public_bytes(Encoding.PEM))
        if certificate.public_key() != key.public_key():
            raise AccessError(Message.of("opcua_not_a_pair", folder=str(file.parent)))
        if not (uri := uri_of(certificate)):
            raise AccessError(Message.of("opcua_no_uri", file=str(file)))
    except (OSError, ValueError, TypeError) as error:
        raise AccessError(Message.of("opcua_files", folder=str(folder), reason=str(error))) from None
    return OwnCertificate(certificate, key, uri)


def _own_key(file: Path) -> rsa.RSAPrivateKey:
    if file.exists():
        key = load_pem_private_key(file.read_bytes(), None)
        if not isinstance(key, rsa.RSAPrivateKey):
            raise ValueError(f"{file} is no RSA key")
        return key
    key = rsa.generate_private_key(65537, KEY_BITS)
    write_file(file, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return key


def _signed(
    key: rsa.RSAPrivateKey, uri: str, names: Sequence[str], site: str, now: datetime
) -> x509.Certificate:
    subject = x509.Name(
        [
            x509.NameAttribute(NameOID.COMMON_NAME, f"Lineside {site}"[:64]),
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, "Lineside"),
        ]
    )
    public = key.public_key()
    builder = (
        x509.CertificateBuilder(subject, subject, public, x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=DAYS))
        .add_extension(
            x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri), *_places(names)]), False
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(key_usage(*_USAGES[:4]), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), False
        )
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
    )
    return builder.sign(key, hashes.SHA256())


def _places(names: Sequence[str]) -> Iterable[x509.GeneralName]:
    """Return the names and addresses under which clients reach this machine."""
    return map(alternative_name, dict.fromkeys((socket.gethostname(), *names)))


def alternative_name(name: str) -> x509.GeneralName:
    """Return the name or address of a machine as a certificate has it."""
    try:
        return x509.IPAddress(ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def key_usage(*used: str) -> x509.KeyUsage:
    """Return the usages of a key: those of `used`, and no others."""
    return x509.KeyUsage(**{usage: usage in used for usage in _USAGES})


def uri_of(certificate: x509.Certificate) -> str:
    """Return the application URI in a certificate; empty if it has none."""
    with suppress(x509.ExtensionNotFound, ValueError):
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        return next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), "")
    return ""


@dataclass(slots=True)
class TrustList:
    """The list of trusted clients: those whose certificate is a file in ``trusted``."""

    folder: Path
    _files: dict[Path, tuple[int, int]] = field(default_factory=dict)
    _trusted: dict[Path, bytes] = field(default_factory=dict)

    def read(self) -> None:
        """Read the changed files of the folder ``trusted``."""
        found = _stamps(self.folder / "trusted")
        self._trusted = {path: thumb for path, thumb in self._trusted.items() if path in found}
        for path, stamp in found.items():
            if self._files.get(path) != stamp:
                self._trusted.pop(path, None)
                with suppress(OSError, ValueError):
                    self._trusted[path] = thumbprint(_loaded(path.read_bytes()).public_bytes(Encoding.DER))
        self._files = found

    def trusts(self, certificate: bytes) -> bool:
        """Return whether a client is trusted by its certificate, as DER."""
        return thumbprint(certificate) in self._trusted.values()

    def reject(self, certificate: bytes) -> None:
        """Store the certificate of a client that is not trusted, so that it can be moved to ``trusted``; only
        the newest are kept. Raise OSError."""
        if len(certificate) > MAX_CERTIFICATE:
            return
        try:
            subject = x509.load_der_x509_certificate(certificate).subject.rfc4514_string()
        except ValueError:
            return
        called = re.search(r"CN=([^,]*)", subject)
        name = re.sub(r"[^A-Za-z0-9._-]+", "_", called[1] if called else "client")[:40]
        rejected = self.folder / "rejected"
        write_file(rejected / f"{name} [{thumbprint(certificate).hex()[:16]}].der", certificate)
        files = sorted(rejected.iterdir(), key=lambda path: path.stat().st_mtime)
        for path in files[:-MAX_REJECTED]:
            path.unlink(missing_ok=True)

    def waiting(self) -> int:
        """Return the number of clients' certificates that wait to be trusted."""
        return len(_stamps(self.folder / "rejected"))


def _stamps(folder: Path) -> dict[Path, tuple[int, int]]:
    """Return the certificate files of a folder, each with its time of change and its size."""
    found: dict[Path, tuple[int, int]] = {}
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.lower().endswith(SUFFIXES) and entry.is_file() and len(found) < MAX_TRUSTED:
                stat = entry.stat()
                if stat.st_size <= 2 * MAX_CERTIFICATE:
                    found[Path(entry.path)] = (stat.st_mtime_ns, stat.st_size)
    return found


def _loaded(data: bytes) -> x509.Certificate:
    if b"-----BEGIN" in data:
        return x509.load_pem_x509_certificate(data)
    return x509.load_der_x509_certificate(data)


def thumbprint(certificate: bytes) -> bytes:
    """Return the SHA-256 of a certificate."""
    return hashlib.sha256(certificate).digest()


@dataclass(slots=True)
class TokenList:
    """The list of the tokens with which programs sign in: the name of a token is the user, its secret the
    password."""

    keys: Mapping[str, Key] = field(default_factory=dict)

    def set(self, keys: Iterable[Key]) -> None:
        """Replace all tokens."""
        self.keys = {key.name: key for key in keys}

    def find(self, name: str, secret: str) -> Key | None:
        """Return the token with which a program signs in; None if it is unknown or has expired."""
        key = self.keys.get(name)
        if key is None or not secrets.compare_digest(secret_hash(secret), key.hash):
            return None
        return key if self.holds(key) else None

    def holds(self, key: Key, now: UnixTime | None = None) -> bool:
        """Return whether programs may still sign in with a token."""
        now = unix_now() if now is None else now
        expires_at = key.expires_at
        return self.keys.get(key.name) == key and (expires_at is None or now < expires_at)


def ends_at(certificate: x509.Certificate) -> UnixTime:
    """Return the end of a certificate."""
    return UnixTime(certificate.not_valid_after_utc.astimezone(UTC).timestamp())
