"""Which part of a store is this server's, where several servers write into one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


def _everything(_: str) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class StoreShare:
    """``server`` names this server in the store; ``buses`` are those that its configuration has; ``is_home``
    returns whether it is the home of a bus now. Any thread calls it."""

    server: str = ""
    buses: Sequence[str] = ()
    is_home: Callable[[str], bool] = _everything

    @property
    def is_complete(self) -> bool:
        """Whether no other server uses the store."""
        return not self.server

    def here(self) -> list[str]:
        """The buses whose home is this server."""
        return [bus for bus in self.buses if self.is_home(bus)]


COMPLETE = StoreShare()
"""One server alone."""
