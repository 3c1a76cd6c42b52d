"""``GET /metrics``, and the sources of the metrics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter
from starlette.responses import Response

from app.alarms.line_alarms import LineAlarms
from app.audit.anchoring import AnchorStatus
from app.audit.log import Event, EventLog
from app.live.state.bus_live import LiveState
from app.web.access import Viewer
from app.web.services import service

OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")


class Counts:
    """Commands by their outcome since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.commands: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Event) -> None:
        if event["kind"] == "command" and event["outcome"]:
            self.commands[event["outcome"]] += 1


@dataclass(frozen=True, slots=True)
class MetricSources:
    """``pages``: how many are open now; ``anchor``: how well the audit log is anchored."""

    live: LiveState
    pages: Callable[[], int]
    counts: Counts
    anchor: Callable[[], AnchorStatus]
    alarms: LineAlarms


router = APIRouter(include_in_schema=False)


@router.get("/metrics")
async def metrics(_: Viewer, measured: Annotated[MetricSources, service(MetricSources)]) -> Response:
    """Prometheus text."""
    from prometheus_client import CONTENT_TYPE_LATEST

    from app.metrics.families import text

    return Response(text(measured), media_type=CONTENT_TYPE_LATEST)
