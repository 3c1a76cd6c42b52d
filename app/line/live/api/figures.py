"""What the wire of a bus carries, as the API shows it."""

from __future__ import annotations

from typing import Annotated

from msgspec.structs import asdict
from pydantic import Field
from typing_extensions import TypedDict

from app.core.web.api.shape import MaybeInstant, iso
from app.line.live.api.schemas import WireShown
from app.line.live.api.view import Json, wire_json
from bus.contract import BusFigures, UnitFigures
from bus.errors import unit_error_name

EventCount = Annotated[int, Field(description="Since the bus worker started.")]
ResponseSeconds = Annotated[float | None, Field(description="Seconds; null: no response yet.")]


class NakCount(TypedDict):
    """How often a unit refused with one error."""

    unit_error: Annotated[int, Field(description="Error code of the NAK, 128 to 137.")]
    unit_error_name: str
    count: EventCount


class UnitStatisticsShown(TypedDict):
    """The counters and response times of one unit."""

    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    polls: EventCount
    responses: Annotated[int, Field(description="Responses since the bus worker started.")]
    timeouts: EventCount
    retries: EventCount
    checksum_errors: EventCount
    foreign: Annotated[
        int, Field(description="Responses that are not of a DIGIMAX IV, since the worker started.")
    ]
    late: Annotated[
        int, Field(description="Responses after their window, or twice, since the worker started.")
    ]
    naks: list[NakCount]
    response_s_min: ResponseSeconds
    response_s_median: ResponseSeconds
    response_s_p99: ResponseSeconds
    response_s_max: ResponseSeconds


class BusStatistics(WireShown):
    """The figures of a bus, measured about once a second; null while no worker measures."""

    bus: str
    measured: Annotated[bool, Field(description="Whether a worker measures; without one all else is null.")]
    at: Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds.")]
    noise_bytes: Annotated[
        int | None, Field(description="Bytes that are no frame, since the worker started.")
    ]
    echoes: Annotated[int | None, Field(description="Own requests received back, since the worker started.")]
    updates_lost: Annotated[
        int | None, Field(description="Readings dropped because the dashboard was away for too long.")
    ]
    responds_for_all: Annotated[
        int | None, Field(description="Unit that seems to respond to every address, 1 to 255; 0: none.")
    ]
    units: list[UnitStatisticsShown]


_COUNTS = ("noise_bytes", "echoes", "updates_lost", "responds_for_all")


def figures_json(bus: str, figures: BusFigures | None) -> Json:
    """The figures of a bus, None where no worker measures them."""
    measured: Json = {name: getattr(figures, name, None) for name in _COUNTS} | wire_json(figures)
    units = [_unit_json(unit) for unit in figures.units] if figures else []
    at = iso(figures.at) if figures else None
    return measured | {"bus": bus, "measured": figures is not None, "at": at, "units": units}


def _unit_json(unit: UnitFigures) -> Json:
    naks = [
        {"unit_error": code, "unit_error_name": unit_error_name(code), "count": count}
        for code, count in sorted(unit.naks.items())
    ]
    return asdict(unit) | {"naks": naks}
