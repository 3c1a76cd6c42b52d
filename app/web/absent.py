"""The refusals of a bus or a unit that lineside.toml does not have."""

from __future__ import annotations

from collections.abc import Iterable

from app.errors import Problem


def unknown_bus(bus: str, known: Iterable[str]) -> Problem:
    """404 for a bus; ``known`` are the names of those that there are."""
    params = {"bus": bus, "known": ", ".join(known) or "none"}
    return Problem(404, "unknown_bus", "there is no bus '{bus}'; there are: {known}", params=params)


def unknown_unit(bus: str, unit: int) -> Problem:
    """404 for a unit of a bus that there is."""
    params = {"bus": bus, "unit": unit}
    detail = "bus '{bus}' has no unit {unit} in lineside.toml"
    return Problem(404, "unknown_unit", detail, params=params, unit=unit)
