"""The homes of this server: taken once everything else runs, and given up before any of that ends."""

from __future__ import annotations

from app.audit.log import EventLog
from app.database import Database
from app.feature import Feature, Services
from app.home.homes import Homes
from app.home.keeping.keeper import HomeKeeper, HomeTerms
from app.home.lease import SITE
from app.home.store import HomeStore
from bus.instants import monotonic_now


def make(services: Services) -> None:
    settings, database = services.settings, services[Database]
    of_site = HomeTerms(permitted=settings.server.home != (), automatic=True)
    of_buses = {
        bus.name: HomeTerms(settings.server.may_be_home(bus.name), bus.is_taken_over) for bus in settings.bus
    }
    keeper = HomeKeeper(
        services[Homes],
        HomeStore(database, monotonic_now),
        services[EventLog],
        {SITE: of_site, **of_buses},
        {bus: lifespan.running for bus, lifespan in services.lifespans_at_home.items()},
        services.ports,
    )
    services.lifespan.enclose(services.add(keeper).running)


FEATURE = Feature(make)
