"""The feature of the plant's database, if configured: its publisher, and alarms for a late one."""

from __future__ import annotations

from app.core.database import Database
from app.feature import Feature, Services
from app.line.alarms.line_alarms import SiteAlarms
from app.line.conditions import catalogue
from app.line.history.service import History
from app.system.postgresql.publisher import Publisher
from bus.instants import unix_now
from bus.messages import Message


def make(services: Services) -> None:
    settings = services.settings
    if settings.postgresql is None:
        return
    site, buses = settings.site.name, settings.bus
    publisher = services.add(
        Publisher(settings.postgresql, site, buses, services[Database], services[History])
    )
    services.lifespan.add("publisher", publisher.follow, end=publisher.end)

    def behind() -> Message | bool:
        status = publisher.status
        return catalogue.PUBLISHER_BEHIND.holds(status.lag_s(unix_now())) and (status.notice or True)

    def day_behind() -> bool:
        return catalogue.PUBLISHER_DAY_BEHIND.holds(publisher.status.lag_s(unix_now()))

    services[SiteAlarms].watch("publisher_behind", behind)
    services[SiteAlarms].watch("publisher_day_behind", day_behind)


FEATURE = Feature(make)
