"""The route of ``/metrics``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from starlette.responses import Response

from app.metrics.measured import MetricSources
from app.web.access import Viewer
from app.web.services import service

router = APIRouter(include_in_schema=False)


@router.get("/metrics")
async def metrics(_: Viewer, measured: Annotated[MetricSources, service(MetricSources)]) -> Response:
    """Prometheus text."""
    from app.metrics.families import CONTENT_TYPE, text

    return Response(text(measured), media_type=CONTENT_TYPE)
