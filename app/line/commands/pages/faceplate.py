"""The faceplate of a unit beside the line, a part of its page."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.services import service_of
from app.line.alarms.line_alarms import LineAlarms
from app.line.commands.forms.page_context import OfUnit, UnitPage
from app.line.commands.review import nudges
from app.line.commands.rules import setpoint_range
from app.line.commands.values import measure_of_setpoint, scale_text, setpoint_scale
from app.line.live.bus_live import follower

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False)


@router.get("/faceplate")
async def faceplate(_: Viewer, page: OfUnit) -> Response:
    """State, cause, alarms with their responses, speed and its field, lamps."""
    alarms = service_of(page.request, LineAlarms).annunciated()
    return page.render(
        "line/_faceplate.html",
        alarms=[a for a in alarms if (a.definition.bus, a.definition.unit) == (page.name, page.id)],
        **setting(page),
    )


def setting(page: UnitPage) -> dict[str, Any]:
    """The unit, and what its setpoint is set by."""
    allowed = setpoint_range(page.unit, page.limits(page.id))
    fine, coarse = nudges(page.unit)
    steps = (1, coarse), (1, fine), (-1, fine), (-1, coarse)
    return {
        "fields": page.fields(),
        "bus": page.name,
        "unit": page.on_line,
        "present": page.setpoint(page.present),
        "lowest": page.setpoint(allowed.lowest),
        "highest": page.setpoint(allowed.highest),
        "bounds_unit": measure_of_setpoint(page.unit),
        "follower": bool(follower(page.unit)),
        "scale": scale_text(setpoint_scale(page.unit, 1)),
        "nudges": [(sign * step, page.setpoint(step), sign) for sign, step in steps],
        "block": page.guards.block_of(page.id),
    }
