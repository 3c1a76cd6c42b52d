"""The refusals of a bus or a unit that lineside.toml does not have."""

from __future__ import annotations

from collections.abc import Iterable

from app.errors import Problem
from bus.messages import Message


def unknown_bus(bus: str, known: Iterable[str]) -> Problem:
    """404 for a bus; ``known`` are the names of those that there are."""
    return Problem(404, "unknown_bus", Message.of("no_such_bus", bus=bus, known=", ".join(known) or "none"))


def unknown_unit(bus: str, unit: int) -> Problem:
    """404 for a unit of a bus that there is."""
    return Problem(404, "unknown_unit", Message.of("no_such_unit", bus=bus, unit=unit), unit=unit)
