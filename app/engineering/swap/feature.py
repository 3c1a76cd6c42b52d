"""Replacement of a unit."""

from __future__ import annotations

from app.core.database import Database
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.saving import SetKeeper
from app.engineering.swap import pages
from app.engineering.swap.service import ACTS, SwapService, SwapStore
from app.feature import Feature, Services
from app.line.commands.service import CommandService
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog


def make(services: Services) -> None:
    commands, keepers = services.of_buses(CommandService), services.of_buses(SetKeeper)
    store, restores, events = SwapStore(services[Database]), services[RestoreService], services[EventLog]
    swaps = services.add(SwapService(services[LiveState], commands, keepers, restores, store, events))
    services.lifespan.add("swaps", start=swaps.load)


FEATURE = Feature(make, (pages.router,), ACTS)
