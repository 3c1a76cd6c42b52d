"""Figures for Prometheus."""

from __future__ import annotations

from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.history.service import History
from app.line.live.bus_live import LiveState
from app.line.live.hub import Hub
from app.people.audit.anchor import Anchoring
from app.people.audit.log import EventLog
from app.system.backup.service import Backups
from app.system.metrics.api import router
from app.system.metrics.sources import CommandCounts, MetricSources
from app.system.postgresql.publisher import Publisher


def make(services: Services) -> None:
    live, hub, alarms = services[LiveState], services[Hub], services[LineAlarms]
    anchoring = services[Anchoring]
    counts = CommandCounts(services[EventLog])
    data = services.settings.server.data
    history, backups = services[History], services[Backups]
    publisher = services[Publisher] if services.settings.postgresql else None
    services.add(
        MetricSources(
            live,
            pages=lambda: hub.connected,
            commands=counts,
            anchor=lambda: anchoring.status,
            alarms=alarms,
            history=lambda: history.status,
            newest_backup=lambda: backups.newest,
            publisher=lambda: None if publisher is None else publisher.status,
            data=data,
        )
    )


FEATURE = Feature(make, (router,))
