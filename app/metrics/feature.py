"""Figures for Prometheus."""

from __future__ import annotations

from app.audit.log import EventLog
from app.feature import Feature, Services
from app.metrics.api import CommandCounts, router


def make(services: Services) -> None:
    services.add(CommandCounts(services[EventLog]))


FEATURE = Feature(make, (router,))
