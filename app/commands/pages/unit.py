"""The unit page."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.responses import Response

from app.commands.forms.page_context import OfUnit, UnitPage
from app.commands.review.ramp import nudges
from app.commands.rules.setpoint_range import setpoint_range
from app.commands.values import measure_of_setpoint
from app.live.state.bus_live import follower
from app.web.access import Viewer
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW, ANALOG_OUT_SOURCE

router = APIRouter(include_in_schema=False)


@router.get("/units/{bus}/{unit:int}")
async def unit_page(_: Viewer, page: OfUnit) -> Response:
    """The faceplate of one unit."""
    return page.render("unit/page.html", **_faceplate(page))


def _faceplate(page: UnitPage) -> dict[str, Any]:
    unit, limits = page.unit, page.limits(page.id)
    allowed = setpoint_range(unit, limits)
    fine, coarse = nudges(unit)
    return {
        "fields": page.fields(),
        "bus": page.name,
        "unit": page.on_line,
        "present": page.setpoint(page.present),
        "lowest": page.setpoint(allowed.lowest),
        "highest": page.setpoint(allowed.highest),
        "bounds_unit": measure_of_setpoint(unit),
        "follower": bool(follower(unit)),
        "nudges": [(sign * step, page.setpoint(step), sign) for sign, step in _signed(fine, coarse)],
        "limit_texts": {name: page.setpoint(getattr(limits, name)) for name in _LIMIT_NAMES},
        "block": page.guards.blocks.of(page.id),
        "analog_low": unit.parameter_raw(ANALOG_OUT_LOW),
        "analog_high": unit.parameter_raw(ANALOG_OUT_HIGH),
        "analog_by_link": unit.parameter_raw(ANALOG_OUT_SOURCE) == 2,
    }


_LIMIT_NAMES = ("lowest", "highest", "largest_step", "per_minute")


def _signed(fine: int, coarse: int) -> list[tuple[int, int]]:
    return [(-1, coarse), (-1, fine), (1, fine), (1, coarse)]
