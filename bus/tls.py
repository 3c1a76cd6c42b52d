"""The TLS files of server and worker, and the dates on which their certificates begin and end.

The dates are read from the files (RFC 7468, RFC 5280), because the library that speaks TLS does not give
those of a certificate that it does not trust.
"""

from __future__ import annotations

import base64
import re
import ssl
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NoReturn

from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

_PEM = re.compile(r"-----BEGIN CERTIFICATE-----\s(.*?)-----END CERTIFICATE-----", re.DOTALL)
_VERSION, _UTC_TIME, _GENERALIZED_TIME = 0xA0, 0x17, 0x18
"""Tags of DER: the optional version of a certificate, and the two forms of a time."""
_FORMATS = {_UTC_TIME: "%y%m%d%H%M%SZ", _GENERALIZED_TIME: "%Y%m%d%H%M%SZ"}
_VALIDITY = 3
"""The place of the validity in a certificate, after serial number, algorithm and issuer."""
_FIRST_CENTURY_UNTIL = 2050
"""The year before which one of two digits is (RFC 5280, 4.1.2.5.1)."""


class MalformedCertificateError(ValueError):
    """Raised for a file without a certificate, or with one that is cut off or malformed."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate. ``der``: its bytes."""

    der: bytes
    begins_at: UnixTime
    ends_at: UnixTime

    @property
    def ends_on(self) -> str:
        """The last day of the certificate in UTC, as ISO 8601 writes it."""
        return datetime.fromtimestamp(float(self.ends_at), UTC).date().isoformat()


def certificates_in(pem: str) -> list[Certificate]:
    """Return the certificates of a file, in its order; a server's own comes first. Raise
    MalformedCertificateError if one is cut off or malformed, or there is none."""
    bodies = _PEM.findall(pem)
    if not bodies or len(bodies) != pem.count("-----BEGIN CERTIFICATE-----"):
        raise MalformedCertificateError("no certificate, or a part of one")
    return [_certificate(body) for body in bodies]


def _certificate(body: str) -> Certificate:
    try:
        der = base64.b64decode("".join(body.split()), validate=True)
        ((_, signed),) = _elements(der)
        _, content = next(_elements(signed))
        fields = [field for field in _elements(content) if field[0] != _VERSION]
        begins, ends = (_time(*field) for field in _elements(fields[_VALIDITY][1]))
    except (ValueError, IndexError, KeyError, StopIteration) as error:
        raise MalformedCertificateError("a malformed certificate") from error
    return Certificate(der, begins, ends)


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield tag and content of each element of a DER sequence. Raise IndexError if it is cut off."""
    at = 0
    while at < len(data):
        tag, length = data[at], data[at + 1]
        at += 2
        if length & 0x80:
            size = length & 0x7F
            length = int.from_bytes(data[at : at + size], "big")
            at += size
        if at + length > len(data):
            raise IndexError("cut off")
        yield tag, data[at : at + length]
        at += length


def _time(tag: int, text: bytes) -> UnixTime:
    at = datetime.strptime(text.decode("ascii"), _FORMATS[tag]).replace(tzinfo=UTC)
    if tag == _UTC_TIME and at.year >= _FIRST_CENTURY_UNTIL:
        at = at.replace(year=at.year - 100)
    return UnixTime(at.timestamp())


WORKER_ALPN = "lineside-worker"
"""The protocol that a worker offers beside HTTP (RFC 7301), so that the server requests its certificate."""
HTTP_ALPN = "http/1.1"
FileStamp = tuple[int, int, int] | None


class TlsFileError(CallerError):
    """Raised for a file that cannot be used; the text names the file and its fault."""


def load_pair(context: ssl.SSLContext, certificate: Path, key: Path) -> Certificate:
    """Load this certificate into the context; return it. Raise TlsFileError."""
    found = read_certificate(certificate)
    _read_key(key)
    files = {"certificate": str(certificate), "key": str(key)}

    def refuse_passphrase() -> NoReturn:
        """Refuse a passphrase, because it would be requested on the terminal."""
        raise TlsFileError(Message.of("tls_key_encrypted", file=str(key)))

    try:
        context.load_cert_chain(certificate, key, refuse_passphrase)
    except OSError as error:
        reason = getattr(error, "reason", None) or error.strerror or str(error)
        if reason == "KEY_VALUES_MISMATCH":
            raise TlsFileError(Message.of("tls_key_differs", **files)) from error
        raise TlsFileError(Message.of("tls_not_usable", **files, reason=reason)) from error
    return found


def load_authority(context: ssl.SSLContext, file: Path) -> None:
    """Make the context trust the certificates of a file. Raise TlsFileError."""
    read_certificate(file)
    try:
        context.load_verify_locations(file)
    except OSError as error:
        raise TlsFileError(Message.of("tls_no_certificate", file=str(file))) from error


def read_certificate(file: Path) -> Certificate:
    """Return the first certificate of a file. Raise TlsFileError if any of it cannot be read."""
    try:
        return certificates_in(_text_of(file))[0]
    except MalformedCertificateError as error:
        raise TlsFileError(Message.of("tls_no_certificate", file=str(file))) from error


def certificate_that_counts(file: Path, which: Callable[..., Certificate]) -> Certificate | None:
    """Return the certificate of a file whose end counts; None if the file cannot be read. ``which``: min for
    a server, which ends with the first of its certificates; max for authorities."""
    try:
        return which(certificates_in(_text_of(file)), key=lambda each: each.ends_at)
    except (MalformedCertificateError, TlsFileError):
        return None


def date_fault(certificate: Certificate, file: Path, now: UnixTime) -> Message | None:
    """Return why a certificate is not valid at ``now``, or None."""
    if certificate.ends_at <= now:
        return Message.of("tls_expired", file=str(file), day=certificate.ends_on)
    return None if certificate.begins_at <= now else Message.of("tls_not_yet_valid", file=str(file))


def stamp_of(file: Path) -> FileStamp:
    """Return a stamp that changes when a file does, or None if there is no file."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _read_key(file: Path) -> None:
    text = _text_of(file)
    if "PRIVATE KEY-----" not in text.partition("-----END ")[2]:
        raise TlsFileError(Message.of("tls_no_key", file=str(file)))


def _text_of(file: Path) -> str:
    try:
        return file.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        reason = error.strerror or str(error)
        raise TlsFileError(Message.of("tls_unreadable", file=str(file), error=reason)) from error
