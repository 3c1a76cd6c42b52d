"""Replacement of a unit."""

from __future__ import annotations

from functools import partial

from app.audit.log import EventLog
from app.database import Database
from app.feature import Feature, Services
from app.sets.restore.restores import RestoreService
from app.swap import pages
from app.swap.acts import ACTS
from app.swap.service import SwapService
from app.swap.store import SwapStore
from bus.instants import unix_now


def make(services: Services) -> None:
    store, restores = SwapStore(services[Database]), services[RestoreService]
    swaps = services.add(SwapService(services[EventLog], store, restores, unix_now))
    for name in services.buses:
        services.lifespan.add(f"swaps of {name}", start=partial(swaps.load, name))


FEATURE = Feature(make, (pages.router,), ACTS)
