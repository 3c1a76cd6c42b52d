"""Replacement of a unit."""

from __future__ import annotations

from app.core.database import Database
from app.engineering.sets.restore_service import RestoreService
from app.engineering.swap import pages
from app.engineering.swap.service import ACTS, SwapService, SwapStore
from app.feature import Feature, Services
from app.people.audit.log import EventLog
from bus.instants import unix_now


def make(services: Services) -> None:
    store, restores = SwapStore(services[Database]), services[RestoreService]
    swaps = services.add(SwapService(services[EventLog], store, restores, unix_now))
    services.lifespan.add("swaps", start=swaps.load)


FEATURE = Feature(make, (pages.router,), ACTS)
