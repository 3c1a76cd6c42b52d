"""Figures for Prometheus."""

from __future__ import annotations

from app.alarms.line_alarms import LineAlarms
from app.audit.anchoring import Anchoring
from app.audit.log import EventLog
from app.feature import Feature, Services
from app.live.browsers.hub import Hub
from app.live.state.bus_live import LiveState
from app.metrics.api import router
from app.metrics.sources import CommandCounts, MetricSources


def make(services: Services) -> None:
    live, hub, alarms = services[LiveState], services[Hub], services[LineAlarms]
    anchoring = services[Anchoring]
    counts = CommandCounts(services[EventLog])
    data = services.settings.server.data
    services.add(MetricSources(live, lambda: hub.connected, counts, lambda: anchoring.status, alarms, data))


FEATURE = Feature(make, (router,))
