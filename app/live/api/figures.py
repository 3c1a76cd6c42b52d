"""What the wire of a bus carries, as the API shows it."""

from __future__ import annotations

from typing import Annotated

from msgspec.structs import asdict
from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.view import Json, wire_json
from app.web.shape import MaybeInstant, MessageShown, iso
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


class BusStatistics(TypedDict):
    """The figures of a bus, measured about once a second; null while no worker measures."""

    bus: str
    measured: Annotated[bool, Field(description="Whether a worker measures; without one all else is null.")]
    at: Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds.")]
    scan_hz: Annotated[float | None, Field(description="Scans per second.")]
    scan_s: Annotated[
        float | None, Field(description="Duration of one scan, seconds; null while no unit responds.")
    ]
    scan_s_with_one_more: Annotated[float | None, Field(description="The same with one unit more, seconds.")]
    wire_utilisation: Annotated[float | None, Field(description="Share of the wire's time in use, 0 to 1.")]
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
    diagnosis: Annotated[str | None, Field(description="Likely cause of faults on the bus; empty: none.")]
    diagnosis_messages: Annotated[list[MessageShown], Field(description="diagnosis as data.")]
    units: list[UnitStatisticsShown]


def figures_json(bus: str, figures: BusFigures | None) -> Json:
    """The figures of a bus, None where no worker measures them."""
    return wire_json(figures) | {
        "bus": bus,
        "measured": figures is not None,
        "at": iso(figures.at) if figures else None,
        "noise_bytes": figures.noise_bytes if figures else None,
        "echoes": figures.echoes if figures else None,
        "updates_lost": figures.updates_lost if figures else None,
        "responds_for_all": figures.responds_for_all if figures else None,
        "diagnosis": " ".join(map(str, figures.diagnosis)) if figures else None,
        "units": [_unit_json(unit) for unit in figures.units] if figures else [],
    }


def _unit_json(unit: UnitFigures) -> Json:
    naks = [
        {"unit_error": code, "unit_error_name": unit_error_name(code), "count": count}
        for code, count in sorted(unit.naks.items())
    ]
    return asdict(unit) | {"naks": naks}
