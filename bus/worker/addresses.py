"""Which of its apps a worker goes to: the server, or its spare. Pure.

A worker goes to addresses that it was started with, and to no other, so that its token goes only where the
person who started it sent it.
"""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import urlsplit, urlunsplit


def feed_url(url: str) -> str:
    """``http(s)://host:port`` or ``ws(s)://host:port/feed`` as the address of the feed."""
    parts = urlsplit(url)
    scheme = {"http": "ws", "https": "wss"}.get(parts.scheme, parts.scheme)
    path = parts.path.rstrip("/")
    return urlunsplit((scheme, parts.netloc, path if path.endswith("/feed") else f"{path}/feed", "", ""))


def is_encrypted(url: str) -> bool:
    """Whether the feed at this address is opened by TLS."""
    return feed_url(url).startswith("wss:")


class AppAddresses:
    """``apps``: at least one address."""

    def __init__(self, apps: Sequence[str]) -> None:
        self._feeds = tuple(dict.fromkeys(map(feed_url, apps)))
        self._at = 0

    @property
    def feed(self) -> str:
        """The one to connect to."""
        return self._feeds[self._at]

    @property
    def are_several(self) -> bool:
        return len(self._feeds) > 1

    def leave(self) -> None:
        """Go to the next: this one does not take the worker."""
        self._at = (self._at + 1) % len(self._feeds)
