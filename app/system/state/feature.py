"""The page *System*."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.templating import render
from app.feature import Feature, Services
from app.system.state.rows import system_rows
from bus.instants import monotonic_now, unix_now

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@router.get("/system", dependencies=[SEARCH])
async def system_page(request: Request, _: Viewer) -> Response:
    """Show what guards the records of this server: its state, its last and next time, and what to do."""
    services: Services = request.app.state.services
    rows = await system_rows(services, unix_now(), monotonic_now())
    return render(request, "system/page.html", rows=rows)


def make(_: Services) -> None:
    """Add no service: the page shows those of others."""


FEATURE = Feature(make, (router,))
