"""What a setpoint of a unit may be, over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from app.commands.api.safeguards import BusInPath, Guards
from app.commands.rules.setpoint_range import Basis, SetpointKind, setpoint_range
from app.live.api.schemas import DisplayedValue
from app.live.api.view import setpoint_text
from app.live.lookup import unit_of_bus_or_404
from app.web.access import Viewer
from app.web.api_route import ApiRoute
from app.web.shape import StrictBody

router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["limits, blocks, control"], route_class=ApiRoute)


class SetpointRangeShown(StrictBody):
    """Range of the setpoints of a unit, both ends included."""

    kind: SetpointKind
    lowest_raw: Annotated[int, Field(description="Integer on the wire, 0 to 99999.")]
    highest_raw: Annotated[int, Field(description="Integer on the wire, 0 to 99999.")]
    lowest: DisplayedValue
    highest: DisplayedValue
    basis: Annotated[Basis, Field(description="Source of the limit: 82h, #2, #38 and #31, or an engineer.")]


@router.get("/units/{unit:int}/setpoint-range")
async def get_setpoint_range(_: Viewer, bus: BusInPath, guards: Guards, unit: int) -> SetpointRangeShown:
    """Range of the setpoints of this unit, as on every page and for every write."""
    found = unit_of_bus_or_404(bus, unit)
    allowed = setpoint_range(found, guards.limits.of(unit))
    return SetpointRangeShown(
        kind=allowed.kind,
        lowest_raw=allowed.lowest,
        highest_raw=allowed.highest,
        lowest=setpoint_text(found, allowed.lowest),
        highest=setpoint_text(found, allowed.highest),
        basis=allowed.basis,
    )
