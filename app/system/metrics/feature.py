"""The feature of metrics: ``GET /metrics`` for Prometheus."""

from __future__ import annotations

from collections import Counter

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.routes import GuardedRoute
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.history.service import History
from app.line.live.bus_live import LiveState
from app.line.live.hub import Hub
from app.people.audit.anchor import Anchoring
from app.people.audit.log import EventLog, Logged
from app.system.backup.service import Backups
from app.system.mqtt.session import Nodes
from app.system.opcua.settings import OpcuaProcesses
from app.system.postgresql.publisher import Publisher

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
OUTCOMES = ("verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed")


class CommandCounts:
    """The numbers of commands by outcome since the server started."""

    def __init__(self, events: EventLog) -> None:
        self.by_outcome: Counter[str] = Counter(dict.fromkeys(OUTCOMES, 0))
        events.subscribe(self._see)

    def _see(self, event: Logged) -> None:
        if event.kind == "command" and event.outcome:
            self.by_outcome[event.outcome] += 1


@router.get("/metrics")
async def metrics(request: Request, _: Viewer) -> Response:
    """Return the metrics as Prometheus text."""
    # Imported with the first request, as the start does not need them.
    from prometheus_client import CONTENT_TYPE_LATEST

    from app.system.metrics.families import Measured, text

    services: Services = request.app.state.services
    measured = Measured(
        live=services[LiveState],
        pages=services[Hub].connected,
        commands=services[CommandCounts].by_outcome,
        anchor=services[Anchoring].status,
        alarms=services[LineAlarms],
        history=services[History].status,
        newest_backup=services[Backups].newest,
        publisher=services[Publisher].status if services.settings.postgresql else None,
        nodes=services[Nodes] if services.settings.mqtt else None,
        opcua=services[OpcuaProcesses],
        data=services.settings.server.data,
    )
    return Response(text(measured), media_type=CONTENT_TYPE_LATEST)


def make(services: Services) -> None:
    services.add(CommandCounts(services[EventLog]))


FEATURE = Feature(make, (router,))
