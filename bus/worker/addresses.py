"""Which of its apps a worker goes to. Pure.

A worker goes to addresses that it was started with, and to no other: a server may name the home of the bus,
and where that is not among them, it is a text for the log. The token therefore goes only where the person who
started the worker sent it.
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
        self._was_sent = False

    @property
    def feed(self) -> str:
        """The one to connect to."""
        return self._feeds[self._at]

    @property
    def are_several(self) -> bool:
        return len(self._feeds) > 1

    def linked(self) -> None:
        """This one is the home."""
        self._was_sent = False

    def leave(self, home: str = "") -> bool:
        """It is not this one: go to the ``home`` that it names where that is among the addresses, else to the
        next. Returns whether it goes to the home; two that name each other are believed once."""
        named = feed_url(home).lower() if home else ""
        known = [feed.lower() for feed in self._feeds]
        if named in known and known.index(named) != self._at and not self._was_sent:
            self._at, self._was_sent = known.index(named), True
            return True
        self._at = (self._at + 1) % len(self._feeds)
        return False
