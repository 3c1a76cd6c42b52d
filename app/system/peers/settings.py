"""The settings of other servers whose lines are shown here (``[[peer]]`` of lineside.toml)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from app.core.server.settings import WebUrl, is_loopback
from bus.messages import Message
from bus.settings import StrictModel
from bus.validation import OneLine, setting_fault


def _server_address(written: str) -> str:
    """Return the URL without a final slash. Raise ValueError for the URL of a page."""
    parts = urlsplit(written)
    if parts.path not in ("", "/") or parts.query or parts.fragment:
        raise setting_fault(Message("setting_peer_url"))
    return written.rstrip("/")


class PeerSettings(StrictModel):
    """A server other than this one. ``token_file``: contains a token of that server with the role viewer;
    ``ca_file``: the authorities to trust instead of those of the machine."""

    name: Annotated[OneLine, Field(min_length=1, max_length=80)]
    url: Annotated[WebUrl, AfterValidator(_server_address)]
    token_file: Path
    ca_file: Path | None = None

    @property
    def is_in_clear(self) -> bool:
        """Whether the token passes other machines without TLS."""
        parts = urlsplit(self.url)
        return parts.scheme == "http" and not is_loopback(parts.hostname or "")


def refuse_repeated(peers: Iterable[PeerSettings]) -> None:
    """Raise PydanticCustomError for two peers with the same name or address."""
    known: dict[str, str] = {}
    for index, peer in enumerate(peers):
        for key, value in (("name", peer.name), ("url", peer.url.lower())):
            if value in known and known[value] == key:
                message = Message.of("setting_peer_twice", key=key, value=value)
                raise setting_fault(message, index, key)
            known[value] = key
