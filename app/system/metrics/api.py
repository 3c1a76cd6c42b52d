"""``GET /metrics``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.services import service
from app.system.metrics.sources import MetricSources

router = APIRouter(include_in_schema=False)


@router.get("/metrics")
async def metrics(_: Viewer, measured: Annotated[MetricSources, service(MetricSources)]) -> Response:
    """Prometheus text."""
    from prometheus_client import CONTENT_TYPE_LATEST

    from app.system.metrics.families import text

    return Response(text(measured), media_type=CONTENT_TYPE_LATEST)
