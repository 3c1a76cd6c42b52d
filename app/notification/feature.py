"""Notification of people about alarms."""

from __future__ import annotations

from app.alarms.monitor.bus_alarms import BusAlarms
from app.alarms.monitor.site_alarms import FailingEndpoints, SiteAlarms
from app.audit.log import EventLog
from app.database import Database
from app.feature import Feature, Services
from app.notification import api, pages
from app.notification.acts import ACTS
from app.notification.notice import ReportAttachments
from app.notification.notifier import AlarmNotifier
from app.notification.service import Notification
from app.web.rendering.templating import Templates


def make(services: Services) -> None:
    database, events, languages = services[Database], services[EventLog], services[Templates].languages
    failing = services[FailingEndpoints]
    notification = services.add(
        Notification(
            services.settings,
            database,
            events,
            failing,
            languages,
            services.local_time,
            services[ReportAttachments],
        )
    )
    services.lifespan.add("notification", notification.dispatcher.follow, start=notification.load)
    for name, bus in services.buses.items():
        alarms = bus[BusAlarms]
        notifier = bus.add(AlarmNotifier(notification, name, alarms.list, alarms.place))
        services.lifespan.add(f"notification of {name}", notifier.follow, start=notifier.load)
    of_site = AlarmNotifier(notification, None, services[SiteAlarms].list, lambda _: "")
    services.lifespan.add("notification of the site", of_site.follow, start=of_site.load)


FEATURE = Feature(make, (api.router, pages.router), ACTS)
