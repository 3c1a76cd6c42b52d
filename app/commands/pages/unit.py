"""The unit page."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from starlette.responses import Response

from app.commands.forms.page_context import Page, PageContext
from app.commands.review.ramp import nudges, present_setpoint
from app.commands.rules.setpoint_range import setpoint_range
from app.commands.values import measure_of_setpoint
from app.live.state.bus_live import UnitLive, follower
from app.web.access import Viewer
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW, ANALOG_OUT_SOURCE

router = APIRouter(include_in_schema=False)


@router.get("/units/{bus}/{unit:int}")
async def unit_page(_: Viewer, page: Page, bus: str, unit: int) -> Response:
    """The faceplate of one unit."""
    live = page.unit(bus, unit)
    return page.render("unit/page.html", **_faceplate(page, bus, live))


def _faceplate(page: PageContext, bus: str, live: UnitLive) -> dict[str, Any]:
    unit, limits = live.settings.id, page.guards(bus).limits.of(live.settings.id)
    allowed = setpoint_range(live, limits)
    present = present_setpoint(page.bus(bus), live)
    fine, coarse = nudges(live)
    return {
        "fields": page.fields(),
        "bus": bus,
        "unit": page.shown(bus, unit),
        "present": page.setpoint(present, live),
        "present_raw": "" if present is None else present,
        "lowest": page.setpoint(allowed.lowest, live),
        "highest": page.setpoint(allowed.highest, live),
        "bounds_unit": measure_of_setpoint(live),
        "follower": bool(follower(live)),
        "nudges": [(sign * step, page.setpoint(step, live), sign) for sign, step in _signed(fine, coarse)],
        "limits": limits,
        "limit_texts": {name: page.setpoint(getattr(limits, name), live) for name in _LIMIT_NAMES},
        "block": page.guards(bus).blocks.of(unit),
        "analog_low": live.parameter_raw(ANALOG_OUT_LOW),
        "analog_high": live.parameter_raw(ANALOG_OUT_HIGH),
        "analog_by_link": live.parameter_raw(ANALOG_OUT_SOURCE) == 2,
    }


_LIMIT_NAMES = ("lowest", "highest", "largest_step", "per_minute")


def _signed(fine: int, coarse: int) -> list[tuple[int, int]]:
    return [(-1, coarse), (-1, fine), (1, fine), (1, coarse)]
