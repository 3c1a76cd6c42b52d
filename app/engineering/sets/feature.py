"""Parameter sets: taken, scheduled, compared, restored."""

from __future__ import annotations

from functools import partial

from app.core.database import Database
from app.core.web.services import Registry
from app.engineering.sets import api, batch_pages, pages
from app.engineering.sets.acts import ACTS
from app.engineering.sets.comparison.drift import BusDrift
from app.engineering.sets.restore import api as restore_api
from app.engineering.sets.restore import pages as restore_pages
from app.engineering.sets.restore.restores import RestoreService
from app.engineering.sets.restore.store import RestoreStore
from app.engineering.sets.saving.first_write import FirstWrites
from app.engineering.sets.saving.keeper import SetKeeper
from app.engineering.sets.saving.reading import ParameterReader
from app.engineering.sets.saving.schedule import SERVER, SetSchedule
from app.engineering.sets.saving.taking import Takings
from app.engineering.sets.store import SetStore
from app.feature import Feature, Services
from app.line.commands.service.command_service import CommandService
from app.line.live.state.bus_live import BusLive
from app.people.audit.log import EventLog
from app.people.auth.rights.rights import Rights


def make(services: Services) -> None:
    services.add(SetStore(services[Database]))
    for name, bus in services.buses.items():
        _make_of_bus(services, name, bus)
    takings = services.add(Takings())
    services.lifespan.add("readings of sets", end=takings.background.close)
    readers, commands = services.of_buses(ParameterReader), services.of_buses(CommandService)
    store = RestoreStore(services[Database])
    restores = services.add(RestoreService(readers, commands, services[EventLog], store))
    for name in services.buses:
        load, end = partial(restores.load, name), partial(restores.background.close, name)
        services.lifespan.add(f"restores of {name}", start=load, end=end)


def _make_of_bus(services: Services, name: str, bus: Registry) -> None:
    live, commands, events, store = bus[BusLive], bus[CommandService], services[EventLog], services[SetStore]
    reader = bus.add(ParameterReader(live, commands))
    drift = bus.add(BusDrift(live, store, events))
    services.lifespan.add(f"golden sets of {name}", start=drift.load, end=drift.background.close)
    keeper = bus.add(SetKeeper(live, reader, drift, store, events, services[Rights]))
    schedule = bus.add(SetSchedule(live, keeper, events, services.local_time))
    first_writes = bus.add(FirstWrites(live, commands, keeper, services.local_time))
    works = (partial(schedule.follow, SERVER), partial(keeper.learn_marked, SERVER))
    services.lifespan.add(f"sets of {name}", *works, end=first_writes.background.close)


FEATURE = Feature(
    make, (api.router, restore_api.router, pages.router, restore_pages.router, batch_pages.router), ACTS
)
