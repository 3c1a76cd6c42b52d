"""The route of ``/metrics``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from starlette.requests import HTTPConnection
from starlette.responses import Response

from app.audit.anchoring import AnchorStatus
from app.live.hub import Hub
from app.live.state import LiveState
from app.metrics.counts import Counts
from app.web.access import Viewer
from app.web.services import looked_up

router = APIRouter(include_in_schema=False)


def _counted(connection: HTTPConnection) -> tuple[LiveState, Hub, Counts, AnchorStatus]:
    services = connection.app.state.services
    anchor = services.anchoring.status if services.anchoring else AnchorStatus()
    return services.live, services.hub, services.counts, anchor


@router.get("/metrics")
async def metrics(
    _: Viewer, counted: Annotated[tuple[LiveState, Hub, Counts, AnchorStatus], looked_up(_counted)]
) -> Response:
    """Prometheus text."""
    from app.metrics.families import CONTENT_TYPE, text

    return Response(text(*counted), media_type=CONTENT_TYPE)
