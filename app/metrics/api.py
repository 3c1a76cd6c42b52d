"""``GET /metrics``, and the count of commands for it."""

from __future__ import annotations

from collections import Counter
from typing import Annotated

from fastapi import APIRouter
from starlette.responses import Response

from app.alarms.line_alarms import LineAlarms
from app.audit.anchoring import Anchoring
from app.audit.log import Event, EventLog
from app.live.browsers.hub import Hub
from app.live.state.bus_live import LiveState
from app.web.access import Viewer
from app.web.services import service

OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")


class CommandCounts:
    """Commands by their outcome since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.by_outcome: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Event) -> None:
        if event["kind"] == "command" and event["outcome"]:
            self.by_outcome[event["outcome"]] += 1


router = APIRouter(include_in_schema=False)


@router.get("/metrics")
async def metrics(
    _: Viewer,
    live: Annotated[LiveState, service(LiveState)],
    hub: Annotated[Hub, service(Hub)],
    counts: Annotated[CommandCounts, service(CommandCounts)],
    alarms: Annotated[LineAlarms, service(LineAlarms)],
    anchoring: Annotated[Anchoring, service(Anchoring)],
) -> Response:
    """Prometheus text."""
    from prometheus_client import CONTENT_TYPE_LATEST

    from app.metrics.families import LineCollector, text

    line = LineCollector(live, hub.connected, counts.by_outcome, alarms, anchoring.status)
    return Response(text(line), media_type=CONTENT_TYPE_LATEST)
