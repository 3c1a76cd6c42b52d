"""What routing needs to know of the homes of the buses."""

from __future__ import annotations

from typing import Protocol

from app.home.homes import Home


class BusHomes(Protocol):
    """The homes of all buses, from memory. ``server``: the id of this one; ``is_shared``: the store is one
    that other servers use too; where it is not, this server is the home of every bus."""

    @property
    def server(self) -> str: ...

    @property
    def is_shared(self) -> bool: ...

    def of(self, bus: str) -> Home:
        """The home of a bus, its server empty where that is not known."""

    def epoch(self, bus: str) -> int:
        """The epoch of the home of a bus where it is here."""

    def is_here(self, bus: str) -> bool:
        """Whether this server is its home."""
