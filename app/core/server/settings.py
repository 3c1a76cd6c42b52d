"""The table ``[server.tls]`` of lineside.toml, rules for addresses, and the reading of secret files:
passwords and keys are read when they are needed, and kept nowhere."""

from __future__ import annotations

import os
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from app.errors import system_error
from bus.errors import LinesideError
from bus.messages import Message
from bus.settings import StrictModel
from bus.validation import setting_fault

MAX_BYTES = 4096


def check_web_url(written: str) -> str:
    """Return a URL of the web. Raise ValueError, without the URL, for any other, and for one with a
    password."""
    try:
        parts = urlsplit(written)
        is_url = parts.scheme in ("https", "http") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_url = False
    if not is_url or not written.isascii() or not written.isprintable() or " " in written:
        raise setting_fault(Message("setting_web_url"))
    if "@" in parts.netloc:
        raise setting_fault(Message("setting_url_with_password"))
    return written


WebUrl = Annotated[str, Field(max_length=2000), AfterValidator(check_web_url)]


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches a server at this host."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class TlsSettings(StrictModel):
    """The settings of HTTPS and WSS: PEM files, relative to the configuration; absolute once loaded."""

    certificate: Path
    """The server's certificate, followed by those that lead to its authority."""
    key: Path
    client_ca: Path | None = None
    """The authority of the workers: each must show a certificate that it has signed."""

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.certificate, self.key, *([self.client_ca] if self.client_ca else []))


class SecretFileError(LinesideError):
    """Raised for a secret file that cannot be used; the text gives the reason, without the content."""


def read_secret(path: Path) -> bytes:
    """Return the content of a file without its final newline. Raise SecretFileError."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            content = file.read(MAX_BYTES + 1) or b""
    except OSError as error:
        reason = system_error(error)
        raise SecretFileError(Message.of("notify_secret_unreadable", path=str(path), reason=reason)) from None
    secret = content.removesuffix(b"\n").removesuffix(b"\r")
    if not secret or len(content) > MAX_BYTES:
        raise SecretFileError(Message.of("notify_secret_empty", path=str(path), n=MAX_BYTES))
    return secret


def read_secret_text(path: Path) -> str:
    """Return the content of a file as one line of ASCII. Raise SecretFileError."""
    try:
        text = read_secret(path).decode("ascii").strip()
    except UnicodeDecodeError:
        text = ""
    if not text or not text.isprintable():
        raise SecretFileError(Message.of("notify_secret_not_text", path=str(path)))
    return text


def can_others_read(path: Path) -> bool:
    """Return whether every user of the machine can read the file."""
    try:
        return bool(path.stat().st_mode & 0o007)
    except OSError:
        return False
