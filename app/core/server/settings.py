"""The table ``[server.tls]`` of lineside.toml, and rules for addresses."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from bus.messages import Message
from bus.settings import StrictModel


def check_web_url(written: str) -> str:
    """Raises ValueError, without the URL, for one that is not of the web or holds a password."""
    try:
        parts = urlsplit(written)
        is_url = parts.scheme in ("https", "http") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_url = False
    if not is_url or not written.isascii() or not written.isprintable() or " " in written:
        raise url_refusal(Message("setting_web_url"))
    if "@" in parts.netloc:
        raise url_refusal(Message("setting_url_with_password"))
    return written


def url_refusal(message: Message) -> PydanticCustomError:
    """Return the fault of a URL; it is shown without the URL, which may be a secret."""
    return PydanticCustomError("web_url", "no such URL", {"message": message, "at": ()})


WebUrl = Annotated[str, Field(max_length=2000), AfterValidator(check_web_url)]


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens there."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class TlsSettings(StrictModel):
    """HTTPS and WSS. PEM files, relative to the configuration; absolute once loaded."""

    certificate: Path
    """The server's certificate, and after it those that lead to its authority."""
    key: Path
    client_ca: Path | None = None
    """The authority of the workers: each must show a certificate that it has signed."""

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.certificate, self.key, *([self.client_ca] if self.client_ca else []))
