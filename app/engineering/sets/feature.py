"""The feature of parameter sets: save, schedule, compare, restore."""

from __future__ import annotations

from functools import partial

from app.core.database import Database
from app.core.web.services import Registry
from app.engineering.sets import api, batch, pages, restore_api
from app.engineering.sets.drift import BusDrift
from app.engineering.sets.restore_service import CANCEL, PLAN, START, RestoreService, RestoreStore
from app.engineering.sets.saving import (
    END_SCHEDULE,
    EXPORT_SECRET,
    MARK_GOLDEN,
    SAVE,
    SCHEDULE,
    FirstWrites,
    ParameterReader,
    SetKeeper,
    SetReadings,
    SetSchedule,
)
from app.engineering.sets.store import SetStore
from app.feature import Feature, Services
from app.line.commands.service import CommandService
from app.line.live.bus_live import BusLive
from app.line.live.hub import Hub
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from app.people.auth.rights import Rights


def make(services: Services) -> None:
    services.add(SetStore(services[Database]))
    for name, bus in services.buses.items():
        _make_of_bus(services, name, bus)
    readings = services.add(SetReadings())
    services.lifespan.add("readings of sets", end=readings.background.close)
    readers, commands = services.of_buses(ParameterReader), services.of_buses(CommandService)
    store = RestoreStore(services[Database])
    restores = services.add(RestoreService(readers, commands, services[EventLog], store))
    services.lifespan.add("restores", start=restores.load, end=restores.background.close)


def _make_of_bus(services: Services, name: str, bus: Registry) -> None:
    live, commands, events, store = bus[BusLive], bus[CommandService], services[EventLog], services[SetStore]
    reader = bus.add(ParameterReader(live, commands))
    drift = bus.add(BusDrift(live, store, events))
    drift.on_change(partial(services[Hub].refresh_unit, name))
    services[Sources].drift[name] = drift
    services.lifespan.add(f"golden sets of {name}", start=drift.load, end=drift.background.close)
    keeper = bus.add(SetKeeper(live, reader, drift, store, events, services[Rights]))
    schedule = bus.add(SetSchedule(live, keeper, events, services.local_time))
    first_writes = bus.add(FirstWrites(live, commands, keeper, services.local_time))
    services.lifespan.add(
        f"sets of {name}", schedule.follow, keeper.read_marked, end=first_writes.background.close
    )


FEATURE = Feature(
    make,
    (api.router, restore_api.router, pages.router, batch.router),
    (SAVE, MARK_GOLDEN, EXPORT_SECRET, SCHEDULE, END_SCHEDULE, PLAN, START, CANCEL),
)
