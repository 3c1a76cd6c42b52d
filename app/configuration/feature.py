"""The configuration file, changed in the browser and by the API."""

from __future__ import annotations

from app.audit.log import EventLog
from app.configuration import api, bus_pages, pages
from app.configuration.acts import ACTS
from app.configuration.port_scan import PortScan
from app.configuration.restart import Restart
from app.configuration.service import ConfigurationFile, SystemsBeside
from app.configuration.versions import VersionStore
from app.feature import Feature, Services


def make(services: Services) -> None:
    settings = services.settings
    store = VersionStore(settings.server.data)
    file = services.add(ConfigurationFile(settings, store, services[EventLog]))
    services.add(SystemsBeside())
    services.add(Restart(file, services[EventLog]))
    scan = services.add(PortScan())
    services.lifespan.add("configuration", start=file.begin, end=scan.stop)


FEATURE = Feature(make, (api.router, pages.router, bus_pages.router), ACTS)
