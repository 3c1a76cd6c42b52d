"""A report as CSV: its units in rows, or their stops. A figure that is not known is empty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from app.core.web.rendering.csv_file import Cell, Column, CsvForm
from bus.messages import Message, term

_PLACE = (Column("bus", term("Bus")), Column("unit", term("Unit")), Column("name", term("Name")))
_SPAN = (Column("start", term("From"), is_time=True), Column("end", term("To"), is_time=True))
_FIGURES = (
    *(Column("known_s", term("With readings (s)")), Column("running_s", term("Ran (s)"))),
    *(Column("length", term("Length")), Column("length_unit", term("Unit of length"))),
)
_STOPPED = (Column("stops", term("Stops")), Column("stopped_s", term("Stopped (s)")))
_MORE = (
    *(Column("at_speed_s", term("At speed (s)")), Column("unread_s", term("No readings (s)"))),
    *(Column("speed_average", term("Average speed")), Column("speed_greatest", term("Greatest speed"))),
    Column("speed_unit", term("Unit of speed")),
)
_DRAW = (
    *(Column("draw_average", term("Draw")), Column("draw_least", term("Least draw"))),
    Column("draw_greatest", term("Greatest draw")),
)
_COUNTS = (
    *(Column("alarms", term("Alarms")), Column("commands", term("Commands"))),
    Column("by_minute", term("From averages of minutes")),
)
UNIT_COLUMNS = (*_PLACE, *_SPAN, *_FIGURES, *_STOPPED, *_MORE, *_DRAW, *_COUNTS)
STOP_COLUMNS = (
    *_PLACE,
    *(Column("began", term("Began"), is_time=True), Column("ended", term("Ended"), is_time=True)),
    *(Column("seconds", term("Duration (s)")), Column("reason", term("Cause"))),
)


def units_text(report: Mapping[str, Any], form: CsvForm) -> str:
    """The file with a unit in a row."""
    return form.head(UNIT_COLUMNS) + form.rows(UNIT_COLUMNS, _unit_rows(report))


def stops_text(report: Mapping[str, Any], form: CsvForm) -> str:
    """The file with a stop in a row, those of one unit after those of the other."""
    return form.head(STOP_COLUMNS) + form.rows(STOP_COLUMNS, _stop_rows(report, form))


def _unit_rows(report: Mapping[str, Any]) -> Iterator[tuple[Cell, ...]]:
    for unit in report["units"]:
        stops = [stop["seconds"] for stop in unit["stops"]] if "stops" in unit else None
        stopped = (None, None) if stops is None else (len(stops), round(sum(stops), 3))
        draw = unit["draw"] or {}
        yield (
            *_place(unit),
            *(_at(report["start"]), _at(report["until"])),
            *(unit.get(column.name) for column in _FIGURES),
            *stopped,
            *(unit.get(column.name) for column in _MORE),
            *(draw.get(column.name.removeprefix("draw_")) for column in _DRAW),
            *(unit.get(column.name) for column in _COUNTS),
        )


def _stop_rows(report: Mapping[str, Any], form: CsvForm) -> Iterator[tuple[Cell, ...]]:
    for unit in report["units"]:
        for stop in unit.get("stops", ()):
            cause = stop["cause"] if form.language is None else Message(f"report_stop_{stop['cause']}")
            yield (*_place(unit), _at(stop["start"]), _at(stop["end"]), stop["seconds"], cause)


def _place(unit: Mapping[str, Any]) -> tuple[Cell, ...]:
    return unit["bus"], unit["unit"], unit["name"]


def _at(text: str) -> datetime:
    return datetime.fromisoformat(text)
