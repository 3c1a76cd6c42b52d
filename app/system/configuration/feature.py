"""The configuration file, changed in the browser and by the API."""

from __future__ import annotations

from app.feature import Feature, Services
from app.people.audit.log import EventLog
from app.system.configuration import api, pages
from app.system.configuration.document import VersionStore
from app.system.configuration.port_scan import PortScan
from app.system.configuration.service import ACTS, ConfigurationFile, Restart, SystemsBeside


def make(services: Services) -> None:
    settings = services.settings
    store = VersionStore(settings.server.data)
    file = services.add(ConfigurationFile(settings, store, services[EventLog]))
    services.add(SystemsBeside())
    services.add(Restart(file, services[EventLog]))
    scan = services.add(PortScan())
    services.lifespan.add("configuration", start=file.begin, end=scan.stop)


FEATURE = Feature(make, (api.router, pages.router, pages.bus_router), ACTS)
