"""The files of TLS, as server and worker read them, and the protocol by which a worker announces itself."""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import NoReturn

from bus.certificate import Certificate, MalformedCertificateError, certificates_in
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

WORKER_ALPN = "lineside-worker"
"""A worker offers this protocol beside that of HTTP (RFC 7301): the server then requests its certificate."""
HTTP_ALPN = "http/1.1"
FileStamp = tuple[int, int, int] | None


class TlsFileError(CallerError):
    """A file cannot be used; the text names it and its fault."""


def load_pair(context: ssl.SSLContext, certificate: Path, key: Path) -> Certificate:
    """Make the context show this certificate; return it. Raises TlsFileError."""
    found = read_certificate(certificate)
    _read_key(key)
    files = {"certificate": str(certificate), "key": str(key)}

    def refuse_passphrase() -> NoReturn:
        """It would be requested on the terminal."""
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
    """Make the context trust the certificates of a file. Raises TlsFileError."""
    read_certificate(file)
    try:
        context.load_verify_locations(file)
    except OSError as error:
        raise TlsFileError(Message.of("tls_no_certificate", file=str(file))) from error


def read_certificate(file: Path) -> Certificate:
    """The first certificate of a file. Raises TlsFileError where any of it cannot be read."""
    try:
        return certificates_in(_text_of(file))[0]
    except MalformedCertificateError as error:
        raise TlsFileError(Message.of("tls_no_certificate", file=str(file))) from error


def date_fault(certificate: Certificate, file: Path, now: UnixTime) -> Message | None:
    """Why a certificate is not valid now."""
    if certificate.ends_at <= now:
        return Message.of("tls_expired", file=str(file), day=certificate.ends_on)
    return None if certificate.begins_at <= now else Message.of("tls_not_yet_valid", file=str(file))


def stamp_of(file: Path) -> FileStamp:
    """What changes when a file does; None where there is none."""
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
