"""A report as rows of CSV: its units, or their stops. A figure that is not known is empty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from app.web.api.shape import csv_cell

_FIGURES = ("known_s", "running_s", "length", "length_unit")
_MORE = ("at_speed_s", "unread_s", "speed_average", "speed_greatest", "speed_unit")
_DRAW = ("average", "least", "greatest")
_COUNTS = ("alarms", "commands", "by_minute")
UNIT_COLUMNS = (
    *("bus", "unit", "name", "start", "end"),
    *(*_FIGURES, "stops", "stopped_s", *_MORE),
    *(f"draw_{name}" for name in _DRAW),
    *_COUNTS,
)
STOP_COLUMNS = ("bus", "unit", "name", "began", "ended", "seconds", "reason")


def unit_rows(report: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """A unit in a row."""
    yield UNIT_COLUMNS
    for unit in report["units"]:
        stops = [stop["seconds"] for stop in unit["stops"]] if "stops" in unit else None
        stopped = (None, None) if stops is None else (len(stops), round(sum(stops), 3))
        draw = unit["draw"] or {}
        yield _cells(
            *_place(unit),
            *(report["start"], report["until"]),
            *(unit.get(name) for name in _FIGURES),
            *stopped,
            *(unit.get(name) for name in _MORE),
            *(draw.get(name) for name in _DRAW),
            *(unit.get(name) for name in _COUNTS),
        )


def stop_rows(report: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """A stop in a row, those of one unit after those of the other."""
    yield STOP_COLUMNS
    for unit in report["units"]:
        for stop in unit.get("stops", ()):
            yield _cells(*_place(unit), stop["start"], stop["end"], stop["seconds"], stop["cause"])


def _place(unit: Mapping[str, Any]) -> tuple[Any, ...]:
    return unit["bus"], unit["unit"], unit["name"]


def _cells(*cells: Any) -> tuple[str, ...]:
    return tuple("" if cell is None else csv_cell(cell) for cell in cells)
