"""The homes of a shared store, as a test decides them."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.home.homes import Home


@dataclass
class PlayedHomes:
    """``homes``: by bus."""

    server: str = "app-1"
    is_shared: bool = True
    homes: dict[str, Home] = field(default_factory=dict)

    def of(self, bus: str) -> Home:
        """As the rows of the store have it."""
        return self.homes.get(bus) or Home(bus)

    def epoch(self, bus: str) -> int:
        """As the row has it."""
        return self.of(bus).epoch

    def is_here(self, bus: str) -> bool:
        """Whether this server has its row."""
        return self.of(bus).server == self.server

    def put(self, bus: str, server: str, url: str = "") -> None:
        """Make a server the home of a bus."""
        self.homes[bus] = Home(bus, server, url or f"http://{server}:8000", 1)
