"""``GET /metrics``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from starlette.responses import Response

from app.metrics.sources import MetricSources
from app.web.admission.access import Viewer
from app.web.services import service

router = APIRouter(include_in_schema=False)


@router.get("/metrics")
async def metrics(_: Viewer, measured: Annotated[MetricSources, service(MetricSources)]) -> Response:
    """Prometheus text."""
    from prometheus_client import CONTENT_TYPE_LATEST

    from app.metrics.families import text

    return Response(text(measured), media_type=CONTENT_TYPE_LATEST)
