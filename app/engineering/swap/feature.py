"""Replacement of a unit."""

from __future__ import annotations

from functools import partial

from app.core.database import Database
from app.engineering.sets.restore.restores import RestoreService
from app.engineering.swap import pages
from app.engineering.swap.acts import ACTS
from app.engineering.swap.service import SwapService
from app.engineering.swap.store import SwapStore
from app.feature import Feature, Services
from app.people.audit.log import EventLog
from bus.instants import unix_now


def make(services: Services) -> None:
    store, restores = SwapStore(services[Database]), services[RestoreService]
    swaps = services.add(SwapService(services[EventLog], store, restores, unix_now))
    for name in services.buses:
        services.lifespan.add(f"swaps of {name}", start=partial(swaps.load, name))


FEATURE = Feature(make, (pages.router,), ACTS)
