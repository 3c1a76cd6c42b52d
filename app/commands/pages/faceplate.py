"""The faceplate of a unit beside the line, a part of its page."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from app.alarms.line_alarms import LineAlarms
from app.commands.forms.page_context import OfUnit
from app.commands.rules.setpoint_range import setpoint_range
from app.live.state.bus_live import follower
from app.web.access import Viewer
from app.web.services import service_of

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False)


@router.get("/faceplate")
async def faceplate(_: Viewer, page: OfUnit) -> Response:
    """State, cause, alarms with their responses, speed and its field, lamps."""
    allowed = setpoint_range(page.unit, page.limits(page.id))
    alarms = service_of(page.request, LineAlarms).annunciated()
    return page.render(
        "line/_faceplate.html",
        fields=page.fields(),
        unit=page.on_line,
        bus=page.name,
        alarms=[a for a in alarms if (a.definition.bus, a.definition.unit) == (page.name, page.id)],
        present=page.setpoint(page.present),
        lowest=page.setpoint(allowed.lowest),
        highest=page.setpoint(allowed.highest),
        follower=bool(follower(page.unit)),
        block=page.guards.blocks.of(page.id),
    )
