"""What a sheet or a report is about: the site, a line or a unit. Pure."""

from __future__ import annotations

from typing import NamedTuple


class Scope(NamedTuple):
    """``bus`` None: the site; ``unit`` None: all units of the bus."""

    bus: str | None = None
    unit: int | None = None

    def holds(self, bus: str | None, unit: int | None) -> bool:
        """Whether what is about a place is about this."""
        return self.bus in (None, bus) and self.unit in (None, unit)

    def concerns(self, bus: str | None, unit: int | None) -> bool:
        """Whether people of this have to know what is about a place: also of its line, and of the site."""
        return (
            bus is None
            or self.bus is None
            or (bus == self.bus and (unit is None or self.unit in (None, unit)))
        )

    def conditions(self, table: str = "") -> tuple[str, list[object]]:
        """SQL to append to a query of a table with these columns, and its values."""
        named = [(name, value) for name, value in self._asdict().items() if value is not None]
        return "".join(f" AND {table}{name} = ?" for name, _ in named), [value for _, value in named]


EVERYTHING = Scope()
